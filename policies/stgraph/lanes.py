"""What the ego is told of the lanes that its way meets, as nodes of two further types, and how it hears them.

A *lane* node is where a lane crosses the ego's way; a *phantom* node is the foremost place on that lane in which
somebody may be whom nobody has reported (`cad_env.pipeline.observe_lanes`). A graph of objects cannot say that nobody
has looked; these nodes do.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from cad_env.pipeline.observe import HORIZON
from cad_env.pipeline.observe_lanes import LANE_FEATURES
from cad_env.types import STEP
from cad_env.world.drivers import COMMANDED_BRAKING, MAX_ACCELERATION
from cad_env.world.state import COMMAND_DELAY
from policies.layers import Linear, glorot_parameter
from policies.stgraph.config import StGraphConfig
from policies.stgraph.features import NEVER

LANE_INPUTS, PHANTOM_INPUTS = 11, 10
_COLUMN = {name: number for number, name in enumerate(LANE_FEATURES)}


class LaneNodes(NamedTuple):
    """The nodes of B scenes of L lanes each, and their edges to the ego; zero where there is none."""

    lane: Tensor  # (B, L, LANE_INPUTS)
    phantom: Tensor  # (B, L, PHANTOM_INPUTS)
    distance: Tensor  # (B, L) edge of a lane: the way until the ego is on it, in 20 m
    spare: Tensor  # (B, L) edge of a phantom: how much later it is there than the ego is past, in 2 s
    mask: Tensor  # (B, L) bool


def lane_nodes(observation: Mapping[str, Tensor], dtype: torch.dtype) -> LaneNodes:
    """The nodes of a batch of observations; reads `lanes` (B, L, F), `lane_mask` (B, L) and `ego` (B, 4).

    All numbers come out near 1. Beside what is observed a lane node is told how far before the lane the ego would come
    to stand if it braked now, and how long it takes to be past if it goes.
    """
    mask = observation["lane_mask"] != 0
    seen = torch.where(mask[..., None], observation["lanes"], 0).to(dtype)
    told = {name: seen[..., number] for name, number in _COLUMN.items()}
    speed, target = (observation["ego"][:, number, None].to(dtype).expand(mask.shape) for number in (0, 1))
    past = seconds_past(told["through"], speed, target)
    spare = ((told["time"] - past) / 2).clamp(-2, 2)
    left = ((told["reach"] - _stopping_distance(speed)) / 5).clamp(-3, 3)
    distance, limit, hurry = told["reach"] / 20, told["speed"] / 10, speed / 10
    lane = (
        told["x"] / 50, told["y"] / 50, told["cos"], told["sin"], distance, told["through"] / 20, left,
        past.clamp(max=10) / 5, told["age"].clamp(max=2), limit, hurry,
    )  # fmt: skip
    phantom = (
        told["phantom_x"] / 50, told["phantom_y"] / 50, told["phantom_cos"], told["phantom_sin"],
        told["hidden"].clamp(-20, 100) / 50, (told["hidden"] < HORIZON).to(dtype), told["time"] / 5, spare, limit,
        hurry,
    )  # fmt: skip
    exists = mask.to(dtype)
    return LaneNodes(
        torch.stack(lane, dim=-1) * exists[..., None], torch.stack(phantom, dim=-1) * exists[..., None],
        distance * exists, spare * exists, mask,
    )  # fmt: skip


def seconds_past(distance: Tensor, speed: Tensor, target: Tensor) -> Tensor:
    """s for a distance, m, from a speed, m/s, at full acceleration until a target speed; 0 for what lies behind."""
    distance = distance.clamp(min=0)
    target = torch.maximum(target, speed).clamp(min=1)
    until = (target - speed) / MAX_ACCELERATION
    covered = 0.5 * (target + speed) * until
    accelerating = ((speed * speed + 2 * MAX_ACCELERATION * distance).sqrt() - speed) / MAX_ACCELERATION
    return torch.where(distance < covered, accelerating, until + (distance - covered) / target)


def _stopping_distance(speed: Tensor) -> Tensor:
    """As `cad_env.rules.planner.stopping_distance`."""
    return speed * COMMAND_DELAY * STEP + 0.5 * speed * speed / COMMANDED_BRAKING


class LaneAttention(nn.Module):
    r"""What the ego hears of the lanes: one graph attention layer with H heads of D numbers over 2 L nodes.

    Each type :math:`\tau` of node has its own projection, and a phantom is heard by its lane first:

    .. math::
        \mathbf{p}_k = \mathrm{ReLU}(\mathbf{W}_P \mathbf{v}^P_k), \qquad
        \mathbf{l}_k = \mathrm{ReLU}(\mathbf{W}_M [\mathrm{ReLU}(\mathbf{W}_L \mathbf{v}^L_k) \Vert \mathbf{p}_k])

        \alpha_k = \mathrm{softmax}_k \left( \mathrm{LeakyReLU} \left( \mathbf{a}^{\top} [\mathbf{W} \mathbf{h}'_{ego}
            \, \Vert \, \mathbf{W}_\tau \mathbf{h}_k \, \Vert \, \mathbf{w}_\tau e_k] \right) \right)

        \mathbf{h}''_{ego} = \mathrm{ReLU} \left( \mathbf{W} \mathbf{h}'_{ego} + \sum_k \alpha_k
            (\mathbf{W}_\tau \mathbf{h}_k + \mathbf{w}_\tau e_k) \right)

    as Eqs. (2) and (3) of the paper; :math:`\mathbf{h}'_{ego}` is its Eq. (6), biases are left out here.
    Shapes: embedding (B, D) to (B, H * D).
    """

    def __init__(self, config: StGraphConfig, rng: torch.Generator) -> None:
        super().__init__()
        heads, width, inner = config.heads, config.head_width, config.hidden
        self.slope = config.attn_slope
        self.lane = Linear(LANE_INPUTS, inner, rng)  # W_L
        self.phantom = Linear(PHANTOM_INPUTS, inner, rng)  # W_P
        self.meet = Linear(2 * inner, inner, rng)  # W_M
        self.weight = glorot_parameter(rng, width, heads * width, heads * width, width)  # W
        self.lane_weight = glorot_parameter(rng, inner, heads * width, heads * width, inner)  # W of lanes
        self.phantom_weight = glorot_parameter(rng, inner, heads * width, heads * width, inner)
        self.edge_weight = glorot_parameter(rng, 1, heads * width, 2, heads, width)  # w of lanes and of phantoms
        self.attend_target = glorot_parameter(rng, width, 1, heads, width)  # a, in its three parts
        self.attend_source = glorot_parameter(rng, width, 1, 2, heads, width)
        self.attend_edge = glorot_parameter(rng, width, 1, 2, heads, width)

    def forward(self, embedding: Tensor, nodes: LaneNodes) -> Tensor:
        """(B, H * D) for the embedding (B, D) of the scene around the ego."""
        phantom = functional.relu(self.phantom(nodes.phantom))
        lane = functional.relu(self.meet(torch.cat([functional.relu(self.lane(nodes.lane)), phantom], dim=-1)))
        heads, width = self.attend_target.shape
        own = (embedding @ self.weight.T).view(-1, heads, width)
        target = (own * self.attend_target).sum(-1)[:, None]
        values, scores = [], []
        for kind, (hidden, weight, edge) in enumerate(
            ((lane, self.lane_weight, nodes.distance), (phantom, self.phantom_weight, nodes.spare))
        ):
            projected = (hidden @ weight.T).view(*hidden.shape[:2], heads, width)
            length = edge[..., None, None] * self.edge_weight[kind]
            score = (projected * self.attend_source[kind]).sum(-1) + (length * self.attend_edge[kind]).sum(-1)
            values.append(projected + length)
            scores.append(functional.leaky_relu(target + score, self.slope))
        exists = torch.cat([nodes.mask, nodes.mask], dim=1)[..., None]
        alpha = torch.softmax(torch.cat(scores, dim=1).masked_fill(~exists, NEVER), dim=1) * exists
        heard = (alpha[..., None] * torch.cat(values, dim=1)).sum(1)
        return functional.relu(own + heard).flatten(1)
