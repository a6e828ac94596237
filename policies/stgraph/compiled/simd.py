"""Four numbers in one register: numba by itself computes four equal sums side by side one by one.

A quad lives inside compiled functions only. It is loaded from, and stored to, four neighbouring numbers of a contiguous
array in double precision, and takes + - * / and `positive`, number by number.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

LANES = 4
_REGISTER = ir.VectorType(ir.DoubleType(), LANES)
_INSTRUCTIONS = {
    "fadd": (operator.add, operator.iadd),
    "fsub": (operator.sub, operator.isub),
    "fmul": (operator.mul, operator.imul),
    "fdiv": (operator.truediv, operator.itruediv),
}


class _QuadType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Quad")


@register_model(_QuadType)
class _QuadModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _REGISTER)  # type: ignore[no-untyped-call]


_QUAD = _QuadType()

# Calls leave out the first argument, which is numba's own.
in_caller: Callable[[Callable[..., Any]], Callable[..., Any]] = intrinsic


@in_caller
def load(typing: Any, array: Any, row: Any) -> Any:
    """The numbers 4 row to 4 row + 3 of an array, counted through all of its axes; nothing checks the bounds."""

    def generate(context: Any, builder: Any, sign: Any, given: Any) -> Any:
        return builder.load(_address(context, builder, sign.args[0], *given), align=8)

    return (_QUAD(array, types.intp), generate) if _holds_quads(array) else None


@in_caller
def store(typing: Any, array: Any, row: Any, quad: Any) -> Any:
    """Put four numbers where `load` would find them."""

    def generate(context: Any, builder: Any, sign: Any, given: Any) -> Any:
        builder.store(given[2], _address(context, builder, sign.args[0], *given[:2]), align=8)
        return context.get_dummy_value()

    return (types.void(array, types.intp, _QUAD), generate) if _holds_quads(array) else None


@in_caller
def fourfold(typing: Any, number: Any) -> Any:
    """The same number four times."""

    def generate(context: Any, builder: Any, sign: Any, given: Any) -> Any:
        one = builder.insert_element(ir.Constant(_REGISTER, ir.Undefined), given[0], ir.IntType(32)(0))
        return builder.shuffle_vector(one, one, ir.VectorType(ir.IntType(32), LANES)([0] * LANES))

    return _QUAD(types.float64), generate


@in_caller
def positive(typing: Any, x: Any, yes: Any, no: Any) -> Any:
    """`yes` where x > 0, else `no`."""

    def generate(context: Any, builder: Any, sign: Any, given: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", given[0], ir.Constant(_REGISTER, [0.0] * LANES)), *given[1:])

    return _QUAD(_QUAD, _QUAD, _QUAD), generate


def _holds_quads(array: Any) -> bool:
    return isinstance(array, types.Array) and array.layout == "C" and array.dtype == types.float64


def _address(context: Any, builder: Any, kind: Any, array: Any, row: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [builder.mul(row, row.type(LANES))]), _REGISTER.as_pointer())


class _OfTwoQuads(AbstractTemplate):
    def generic(self, given: Any, named: Any) -> Any:
        return signature(_QUAD, *given) if tuple(given) == (_QUAD, _QUAD) else None


def _teach(operation: Any, instruction: str) -> None:
    """Make an operator known for quads."""

    def generate(context: Any, builder: Any, sign: Any, given: Any) -> Any:
        return getattr(builder, instruction)(*given)

    infer_global(operation)(type(f"_{operation.__name__}", (_OfTwoQuads,), {}))
    lower_builtin(operation, _QUAD, _QUAD)(generate)


for _instruction, _operations in _INSTRUCTIONS.items():
    for _operation in _operations:
        _teach(_operation, _instruction)
