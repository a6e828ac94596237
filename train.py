"""Record the expert, clone it with and without sharing, score both in closed loop, print the table.

python train.py                                      the main job, some minutes on two cores
python train.py --scenario left_turn                 networks that know this scenario only
python train.py --method gat collab-gat --seed 0 1 2    other methods (baselines/methods.py), three times each
python train.py --episodes 200 --dagger-rounds 0 --steps 600 --score 50 --out runs/quick     a quick look

python train.py --method my_network:SPEC             a network of your own (docs/write-your-own.md)

Run the same command to resume after an interruption.
"""

import sys

from baselines.training.command import main

if __name__ == "__main__":
    sys.exit(main())
