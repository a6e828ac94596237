"""The figures as a table, with what it says about the bars."""

import statistics

BARS = {  # figure -> (least or most, bar)
    "world step, 12 vehicles, 64 scenes (1/s)": ("least", 150_000.0),
    "env.step, ego + 3 collaborators (1/s)": ("least", 8_000.0),
    "env.step over peer at 10 Hz": ("least", 40.0),
    "vector env, 64 scenes (1/s)": ("least", 15_000.0),
    "vector env, 256 scenes (1/s)": ("least", 15_000.0),
    "parallel env, 4 agents (1/s)": ("least", 6_000.0),
    "parallel env over peer's multi-agent env": ("least", 50.0),
    "reset (ms)": ("most", 2.0),
    "step and decision, 4 vehicles, batch 1, median (ms)": ("most", 0.4),
    "step and decision, 4 vehicles, batch 1, 99th percentile (ms)": ("most", 1.0),
    "network alone, 12 tracks x 15 frames, batch 1 (ms)": ("most", 0.2),
    "training, fused, left_turn (graphs/s)": ("least", 2_500.0),
    "training, fused, overtaking (graphs/s)": ("least", 2_500.0),
    "training, fused, street_crossing (graphs/s)": ("least", 2_500.0),
    "training, fused over PyG twin": ("least", 4.0),
    "memory, 1,024 scenes (MB)": ("most", 1024.0),
    "demonstrations 1,000 expert episodes, CPU (s)": ("most", 30.0),
    "evaluate.py, 500 episodes of stgraph, 2 processes, wall (s)": ("most", 30.0),
}


def verdict(name: str, value: float) -> str:
    """What the table says about the bar of a figure."""
    if name not in BARS:
        return ""
    sense, bar = BARS[name]
    met = value >= bar if sense == "least" else value <= bar
    return f"at {sense} {bar:,g}: {'met' if met else 'NOT MET'}"


def tabled(figures: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    """Print the table; the same numbers as a record."""
    rows = {}
    print(f"{'figure':64} {'median':>10} {'least':>10} {'most':>10}  bar")
    for name, values in figures.items():
        middle = statistics.median(values)
        rows[name.strip()] = {"median": middle, "least": min(values), "most": max(values)}
        numbers = " ".join(
            f"{x:10,.0f}" if abs(x) >= 1000 else f"{x:10.3g}" for x in (middle, min(values), max(values))
        )
        print(f"{name:64} {numbers}  {verdict(name, middle)}".rstrip())
    return rows
