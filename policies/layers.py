"""Layers that several networks share."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


def uniform_parameter(rng: torch.Generator, bound: float, *shape: int) -> nn.Parameter:
    """A parameter of independent uniform numbers from -bound to bound."""
    return nn.Parameter(torch.empty(*shape).uniform_(-bound, bound, generator=rng))


def glorot_parameter(rng: torch.Generator, fan_in: int, fan_out: int, *shape: int) -> nn.Parameter:
    """A parameter by Glorot and Bengio (AISTATS 2010): uniform within sqrt(6 / (fan_in + fan_out))."""
    return uniform_parameter(rng, math.sqrt(6 / (fan_in + fan_out)), *shape)


class Linear(nn.Module):
    """An affine map whose first weights come from the given rng, as torch's own draws them."""

    def __init__(self, inputs: int, outputs: int, rng: torch.Generator) -> None:
        super().__init__()
        self.weight = uniform_parameter(rng, 1 / math.sqrt(inputs), outputs, inputs)
        self.bias = uniform_parameter(rng, 1 / math.sqrt(inputs), outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(..., outputs) for x (..., inputs)."""
        return functional.linear(x, self.weight, self.bias)
