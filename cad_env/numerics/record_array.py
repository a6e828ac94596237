"""Records of arrays on a records: bytes, from which compiled code takes any of them without a call of its own.

Numba hands a record of a hundred arrays over one by one, which takes 20 us from Python, and counts references to each
whenever it takes one out of another, some thousand times in a step. From a records a record is *borrowed*: it is where
its arrays are and of what shape, and nobody counts. The bytes keep alive whoever has lent them an array.
"""

import copy
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core import config as numba_config
from numba.core.errors import TypingError
from numba.extending import intrinsic

from cad_env.numerics.jit import compiled

_Self = TypeVar("_Self", bound="CopiedWhole")


def _address(context: Any, builder: Any, kind: Any, array_kind: Any, records: Any, place: Any) -> Any:
    """Where the record of a place begins, as a pointer to it."""
    stored = context.get_data_type(kind)
    array = context.make_array(array_kind)(context, builder, records)
    first = builder.bitcast(array.data, stored.as_pointer())
    return builder.gep(first, [place])


def _load(context: Any, builder: Any, kind: Any, pointer: Any) -> Any:
    """A value as machine code has it, with the owners of its arrays taken out."""
    if isinstance(kind, types.BaseTuple):
        value = context.get_constant_undef(kind)
        for index, part in enumerate(kind.types):  # type: ignore[attr-defined]
            inner = _load(context, builder, part, cgutils.gep_inbounds(builder, pointer, 0, index))
            value = builder.insert_value(value, inner, index)
        return value
    value = context.unpack_value(builder, kind, pointer)
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        value = array._getvalue()
    return value


def _lend(typing: Any, records: Any, place: Any, kind: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        record = signature.return_type
        return _load(context, builder, record, _address(context, builder, record, records, *values[:2]))

    return kind.instance_type(records, types.intp, kind), generate


def _store(typing: Any, records: Any, place: Any, kind: Any, record: Any) -> Any:
    if record != kind.instance_type:
        raise TypingError(f"this records is for {kind.instance_type}, not for {record}")

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        context.pack_value(builder, record, values[3], _address(context, builder, record, records, *values[:2]))
        return context.get_dummy_value()

    return types.void(records, types.intp, kind, record), generate


def _size(typing: Any, kind: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        size = context.get_abi_sizeof(context.get_data_type(kind.instance_type))
        return context.get_constant(types.intp, size)

    return types.intp(kind), generate


def _listed(records: Any, place: int, kind: Any) -> Any:
    return records[place]


def _list(records: Any, place: int, kind: Any, record: Any) -> None:
    records[place] = record


# For compiled code: the record of `kind`, a numba type, at a place; and put one there, of exactly this type.
take: Callable[[Any, Any, Any], Any] = _listed
put: Callable[[Any, Any, Any, Any], None] = _list
if not numba_config.DISABLE_JIT:
    _part_of_the_compiler: Any = intrinsic
    take, put, _bytes = (_part_of_the_compiler(each) for each in (_lend, _store, _size))

    @compiled
    def size_of(kind: Any) -> int:
        """Bytes of a record."""
        return int(_bytes(kind))


class _Memory(bytearray):
    """Bytes that hold on to something."""

    held: Any


def new_record_array(kind: Any, places: int, lenders: dict[int, Any]) -> Any:
    """An empty records for so many records of `kind`, which keeps alive all that is in `lenders` as long as itself.

    Who puts a record at a place puts it into `lenders` too. It must not be copied: the bytes are addresses, so that the
    copy would borrow the original's arrays, and keep none of them alive. In plain Python a records is a list.
    """
    if numba_config.DISABLE_JIT:
        return [None] * places
    memory = _Memory(places * size_of(kind))
    memory.held = lenders
    return np.frombuffer(memory, np.uint8)


class CopiedWhole:
    """What stands on borrowed arrays: `copy.copy` gives as much as `copy.deepcopy`, or two would move one world."""

    def __copy__(self: _Self) -> _Self:
        return copy.deepcopy(self)
