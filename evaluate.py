"""Score methods in closed loop, on the same seeds, and print the table with its intervals.

python evaluate.py --scenario left_turn --method always-go expert stgraph --episodes 500 --jobs 2
python evaluate.py --models runs/all/seed_0 runs/all/seed_1 --method expert stgraph     a run for each training seed
python evaluate.py --merge results/shard_1_of_2 results/shard_2_of_2
"""

import sys

from baselines.evaluation.command import main

if __name__ == "__main__":
    sys.exit(main())
