"""The network of `policies.stgraph.network`, fused: the same numbers, from compiled loops over the nodes that exist.

Dense attention pays for the whole padded grid and for every array in between. Here a scene costs what it holds.
It knows the paper's reading of the network; any other goes the dense way: `supports` decides.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
import torch
from numba.core import config as numba_config
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from cad_env.types import Floats
from policies.layers import Linear
from policies.stgraph.compiled.attention import HEADS, LayerWeights, multiply
from policies.stgraph.compiled.lanes import FusedLanes
from policies.stgraph.compiled.passes import GraphBatch, Weights, backward, forward
from policies.stgraph.compiled.relation_weights import Matter
from policies.stgraph.config import StGraphConfig
from policies.stgraph.features import ego_way
from policies.stgraph.network import Importance, RelationLayer, StGraphNet

_AT_ONCE = 16  # graphs: what they keep fits into a processor's cache


def supports(config: StGraphConfig) -> bool:
    """Whether the fused network computes this one."""
    return (
        config.temporal
        and config.layers == 2
        and config.heads == HEADS
        and config.head_width % 2 == 0
        and config.fusion == "last"
        and config.temporal_edges == "all"
        and not (config.node_time or config.relu_logits or config.ego_speed or config.class_input)
        and not numba_config.DISABLE_JIT
    )


def fused_logits(network: StGraphNet, observation: Mapping[str, Tensor]) -> Tensor:
    """What `network(observation)` gives, logits (B, 2), and its gradients; dense where it is not supported."""
    if not _is_fused(network):
        logits: Tensor = network(observation)
        return logits
    return network.decided(fused_embedding(network, observation), observation)


def fused_embedding(network: StGraphNet, observation: Mapping[str, Tensor]) -> Tensor:
    """What `network.embed(observation)` gives, (B, D), and its gradients; dense where it is not supported."""
    if not _is_fused(network):
        return network.embed(observation)
    read = ("tracks", "mask", "ego", "route")
    batch = _batch({key: observation[key].numpy() for key in read if key in observation}, network.config)
    embedded: Tensor = _Embed.apply(batch, network.config, *_weights(network))  # type: ignore[no-untyped-call]
    return embedded.to(network.project.weight.dtype)


def _is_fused(network: StGraphNet) -> bool:
    return supports(network.config) and network.project.weight.device.type == "cpu"


class FusedNet:
    """A network as it is now, for decisions only, in double precision.

    Every scene is computed by itself and in the same order, so its logits are the same, bit for bit, in any batch.
    """

    def __init__(self, network: StGraphNet) -> None:
        self._config = network.config
        self._lanes = FusedLanes(network.lanes) if network.config.coverage else None
        with torch.no_grad():
            self._weights = _named([weight.numpy().copy() for weight in _weights(network)])
            layers = [layer for layer in network.decide if isinstance(layer, Linear)]
            self._decide = [
                (layer.weight.double().T.numpy().copy(), layer.bias.double().numpy().copy()) for layer in layers
            ]

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> Floats:
        """Logits (B, 2)."""
        parts = _parts(_batch(observation, self._config))
        embedded = [forward(part, self._config, self._weights).embedding for part in parts]
        told = [np.concatenate(embedded), observation["command"]]
        if self._lanes is not None:
            told.append(self._lanes(told[0], observation))
        x = np.concatenate(told, axis=1)
        for weight, bias in self._decide[:-1]:
            x = np.maximum(multiply(x, weight) + bias, 0)
        weight, bias = self._decide[-1]
        logits: Floats = multiply(x, weight) + bias
        return logits


class _Embed(torch.autograd.Function):
    """The embedding (B, D) of a batch, given the flat list of weights."""

    @staticmethod
    def forward(ctx: Any, batch: GraphBatch, config: StGraphConfig, *weights: Tensor) -> Tensor:
        _keep_freed_memory()
        ctx.config, ctx.weights = config, _named([weight.numpy() for weight in weights])
        ctx.passes = [forward(part, config, ctx.weights) for part in _parts(batch)]
        return torch.from_numpy(np.concatenate([done.embedding for done in ctx.passes]))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slopes: Tensor) -> tuple[Tensor | None, ...]:
        into = [np.zeros_like(weight) for weight in _flat(ctx.weights)]
        for index, done in enumerate(ctx.passes):
            part = slopes[index * _AT_ONCE : (index + 1) * _AT_ONCE].contiguous().numpy()
            backward(done, part, ctx.config, ctx.weights, _named(into))
        return None, None, *(torch.from_numpy(gradient) for gradient in into)


@cache
def _keep_freed_memory() -> None:
    """Teach the C library to keep freed memory for the next step: asking the system anew costs a third of a step.

    glibc gives back blocks above a threshold, which follows the largest block freed so far, up to 32 MB.
    """
    np.empty(31 << 20, np.uint8)


def _batch(observation: Mapping[str, NDArray[Any]], config: StGraphConfig) -> GraphBatch:
    """The arrays of a batch, of the one type that the loops are compiled for."""
    tracks, mask = observation["tracks"], observation["mask"]
    if tracks.ndim != 4 or tracks.shape[-1] != 3 or mask.shape != tracks.shape[:-1]:
        raise ValueError(f"tracks must be (B, K, T, 3) and mask (B, K, T), got {tracks.shape} and {mask.shape}")
    return GraphBatch(
        np.ascontiguousarray(tracks, np.float32),
        np.ascontiguousarray(mask != 0).view(np.int8),
        np.ascontiguousarray(observation["ego"] if "ego" in observation else np.zeros((len(mask), 1)), np.float32),
        _told(observation, config),
    )


def _told(observation: Mapping[str, NDArray[Any]], config: StGraphConfig) -> Floats:
    if not config.ego_way:
        return np.zeros((len(observation["mask"]), 0))
    read = {key: torch.from_numpy(np.ascontiguousarray(observation[key])) for key in ("ego", "route")}
    return np.ascontiguousarray(ego_way(read, torch.float64).T.numpy())


def _parts(batch: GraphBatch) -> Iterator[GraphBatch]:
    for at in range(0, max(len(batch.mask), 1), _AT_ONCE):
        part = slice(at, at + _AT_ONCE)
        yield GraphBatch(batch.tracks[part], batch.mask[part], batch.ego[part], batch.told[part])


def _weights(network: StGraphNet) -> list[Tensor]:
    """The weights as the compiled loops want them, in double precision, each a function of the parameters."""
    lift = torch.cat([network.project.weight.T, network.project.bias[None]]).double()  # of (inputs, 1)
    flat: list[Tensor] = []
    for name in network.relations:
        first, second = (network.layers[f"{name}_{depth}"] for depth in range(2))
        assert isinstance(first, RelationLayer)
        assert isinstance(second, RelationLayer)
        # Nothing bends between the lift and the first layer, so the two are one.
        flat += [lift @ _projection(first), *_edge_weights(first)]
        # The first layer's heads come to the second one after another, here number after number.
        heads, width = first.attend_target.shape
        by_head = _projection(second)
        flat += [by_head.view(heads, width, -1).transpose(0, 1).reshape(by_head.shape), *_edge_weights(second)]
    matter = network.importance["1"]
    assert isinstance(matter, Importance)
    flat += [value.double() for value in (matter.weight, matter.bias, matter.query)]
    return [weight.contiguous() for weight in flat]


def _projection(layer: RelationLayer) -> Tensor:
    """(C, L + 8): W and, by it, the scores as a target and as a source."""
    heads, width = layer.attend_target.shape
    value = layer.weight.double().view(heads, width, -1)
    scores = [(attend.double().unsqueeze(1) @ value)[:, 0] for attend in (layer.attend_target, layer.attend_source)]
    return torch.cat([value.transpose(0, 1).flatten(0, 1), *scores]).T


def _edge_weights(layer: RelationLayer) -> list[Tensor]:
    """The score (4,) and the value (L,) of an edge of length 1; an edge without attributes says nothing."""
    if not layer.attributes:
        heads, width = layer.attend_target.shape
        return [torch.zeros(heads, dtype=torch.float64), torch.zeros(heads * width, dtype=torch.float64)]
    value = layer.edge_weight.double()
    return [(layer.attend_edge * value).sum(1), value.T.flatten()]


def _named(flat: list[Floats]) -> Weights:
    """The flat list of `_weights`, by name."""
    layers = [LayerWeights(*flat[at : at + 3]) for at in range(0, 12, 3)]
    return Weights(((layers[0], layers[1]), (layers[2], layers[3])), Matter(*flat[12:]))


def _flat(weights: Weights) -> list[Floats]:
    """The counterpart of `_named`."""
    return [array for relation in weights.layers for layer in relation for array in layer] + list(weights.matter)
