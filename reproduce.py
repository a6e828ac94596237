"""Make every table and plot of the paper's comparison: record, train all rows, score them, sweep, write the report.

python reproduce.py --preset quick                     all rows, one training seed, few episodes: a first look
python reproduce.py --preset hour                      half as many episodes again, and two rounds of corrections
python reproduce.py --preset full --jobs 2             three training seeds, 500 episodes: overnight on two cores
python reproduce.py --preset full --shard 2/8          one of eight parts, on machines that share the folder --out
python reproduce.py --preset full --merge              puts together what the shards have finished

Interrupt it as you like: the same command goes on where it stopped. A row that fails does not stop the others.

Minutes of quick, on two cores, as measured (28 in all):

    record the expert                        under 1
    train all rows                           18, two thirds of it for those of points
    closed loop, open loop and sweeps        9
    tables and plots                         under 1
"""

import sys

from baselines.paper.command import main

if __name__ == "__main__":
    sys.exit(main())
