"""What a vehicle sends, and how: both can come from outside. The budget counts the bytes of either.

python my_sharing.py      a table: the project's own message, the nearest tracks only, JSON in place of the own format
"""

import json
from dataclasses import dataclass, replace

import numpy as np

import cad_env
from cad_env import DecodeError, Graph, Planner


@dataclass(frozen=True)
class NearestOnly:
    """Shares the sender's own body and the tracks nearest to it."""

    tracks: int = 2

    def __call__(self, graph: Graph) -> Graph:
        """The graph with fewer tracks; None would send nothing in this step."""
        newest = graph.position[:, -1, :2]
        away = np.hypot(*(newest - newest[0]).T)
        kept = np.sort(np.argsort(away, kind="stable")[: self.tracks + 1])
        return replace(
            graph, track=graph.track[kept], position=graph.position[kept], mask=graph.mask[kept], kind=graph.kind[kept]
        )


class JsonCodec:
    """Messages that a person can read, and what that costs."""

    def encode(self, graph: Graph) -> bytes:
        """The graph as text: centimetres of every node."""
        tracks = [
            {"id": int(track), "kind": int(kind), "seen": np.flatnonzero(seen).tolist(),
             "cm": np.rint(100 * position[seen]).astype(int).tolist()}
            for track, kind, seen, position in zip(graph.track, graph.kind, graph.mask, graph.position, strict=True)
        ]  # fmt: skip
        return json.dumps({"sender": graph.sender, "time": graph.time, "tracks": tracks}).encode()

    def decode(self, payload: bytes) -> Graph:
        """The counterpart; DecodeError for anything else, whatever the bytes are."""
        try:
            said = json.loads(payload)
            tracks = said["tracks"]
            mask = np.zeros((len(tracks), 15), np.bool_)
            position = np.zeros((len(tracks), 15, 3))
            for row, track in enumerate(tracks):
                mask[row, track["seen"]] = True
                position[row, track["seen"]] = 0.01 * np.array(track["cm"], float).reshape(-1, 3)
            ids, kinds = ([track[name] for track in tracks] for name in ("id", "kind"))
            return Graph(
                int(said["sender"]),
                float(said["time"]),
                np.array(ids, np.int64),
                position,
                mask,
                np.array(kinds, np.int8),
            )
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, RecursionError) as error:
            raise DecodeError(str(error)) from None


def main(episodes: int = 20) -> None:
    """Print what each way of sharing costs, and how often rules on the shared view collide."""
    ways: dict[str, dict] = {
        "own format": {}, "nearest 2": {"share": NearestOnly(2)}, "JSON": {"codec": JsonCodec()},
        "nothing": {"radio": "none"},
    }  # fmt: skip
    print(f"{'shared':12}{'bytes a message':>16}{'collisions':>12}{'arrived':>9}")
    for name, options in ways.items():
        env = cad_env.CADEnv(scenario="left_turn", **{"radio": "dsrc", **options})
        driven = [cad_env.rollout(env, Planner(), seed, hazard=True) for seed in range(episodes)]
        ends = [episode.outcome for episode in driven]
        sent, messages = (sum(int(getattr(e, n).sum()) for e in driven) for n in ("bytes_sent", "messages_sent"))
        size = f"{sent / messages:.0f}" if messages else "-"
        print(f"{name:12}{size:>16}{ends.count('collision'):>12}{ends.count('success'):>9}")


if __name__ == "__main__":
    main()
