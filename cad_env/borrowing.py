"""Records of arrays that compiled code borrows: it counts no references to them.

Numba counts a reference, atomically, whenever it takes an array out of a record, and a step does so some thousand
times: a fifth of its time. An array without an owner is passed over; `lend` keeps the owners alive in Python.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core import config as numba_config
from numba.extending import intrinsic


def _disowned(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """The machine value of a (nested) tuple with the owners of its arrays taken out."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for index, part in enumerate(kind.types):  # type: ignore[attr-defined]
            inner = _disowned(context, builder, part, builder.extract_value(value, index))
            value = builder.insert_value(value, inner, index)
    return value


def _borrow(typing: Any, record: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _disowned(context, builder, signature.return_type, values[0])

    return record(record), generate


def _as_it_is(record: Any) -> Any:
    return record


def lend(scenes: Any, owners: Any) -> Any:
    """A typed list of borrowed records that keeps their owners alive as long as itself; a plain list holds its own."""
    if not isinstance(scenes, list):
        scenes.owners = owners
    return scenes


# For compiled code: the same record, whose arrays somebody else keeps alive.
borrowed: Callable[[Any], Any] = _as_it_is if numba_config.DISABLE_JIT else intrinsic(_borrow)  # type: ignore[assignment]
