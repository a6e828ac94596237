"""A reward of one's own: a function of a step. python my_reward.py prints what two policies earn."""

import cad_env
from cad_env import BRAKE, GO, StepOutcome


def safety_first(step: StepOutcome) -> float:
    """Progress, a little less for every decision, and ten for a collision."""
    return step.progress - 0.002 - 10.0 * (step.outcome == "collision")


def main(episodes: int = 10) -> None:
    """Print the mean return of always going and of braking for the first second."""
    for name, seconds in (("always go", 0.0), ("brake 1 s, then go", 1.0)):
        env = cad_env.CADEnv(scenario="left_turn", reward=safety_first)
        total = 0.0
        for seed in range(episodes):
            _, info = env.reset(seed=seed, options={"hazard": True})
            steps = 0
            while info["outcome"] is None:
                _, reward, _, _, info = env.step(BRAKE if steps < 10 * seconds else GO)
                total, steps = total + reward, steps + 1
        print(f"{name:20}{total / episodes:8.3f}")


if __name__ == "__main__":
    main()
