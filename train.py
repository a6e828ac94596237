"""Record the expert, clone it with and without sharing, score both in closed loop, print the table.

python train.py                                      the main job, some minutes on two cores
python train.py --scenario left_turn                 networks that know this scenario only
python train.py --method gat collab-gat --seed 0 1 2    other rows of the table (baselines/methods.py), three times each
python train.py --episodes 200 --corrections 0 --steps 600 --score 50 --out runs/quick     a quick look

Interrupt it as you like: the same command goes on where it stopped.
"""

import sys

from baselines.training.command import main

if __name__ == "__main__":
    sys.exit(main())
