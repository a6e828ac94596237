"""Rooms that are left out of the name of the cache of machine code hold nothing that is compiled."""

from pathlib import Path

import pytest

from cad_env.numerics import jit

PACKAGE = Path(jit.__file__).parent.parent


@pytest.mark.parametrize("room", jit._NOT_COMPILED)
def test_a_room_outside_the_cache_name_compiles_nothing(room):
    place = PACKAGE / room
    sources = [place] if place.suffix == ".py" else sorted(place.rglob("*.py"))
    assert sources
    for source in sources:
        assert "numerics.jit" not in source.read_text(encoding="utf-8"), source
