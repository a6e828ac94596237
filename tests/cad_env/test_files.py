"""Files are whole or absent, and whatever is wrong with one is said in one line that begins with its path."""

import ast
import json
import os
import pickle
import socket
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cad_env.checks import ConfigError
from cad_env.files import (
    MOST_DIGITS,
    MOST_NESTED,
    MOST_REASON,
    FileError,
    check_regular,
    parse_json,
    read_file,
    read_json,
    read_json_object,
    read_rows,
    read_text,
    replace_text,
)

ROOT = Path(__file__).parents[2]
WRITTEN = ("baselines", "benchmarks", "cad_env", "docs", "examples", "policies")


def refusal(path: Path, read: object, *more: object) -> str:
    """What is said when a file is read that cannot be used."""
    with pytest.raises(FileError) as caught:
        read(path, *more)  # type: ignore[operator]
    said = str(caught.value)
    assert said.startswith(f"{path}: ")
    assert len(said.splitlines()) == 1
    return said.removeprefix(f"{path}: ")


def test_bytes_and_text_come_back(tmp_path: Path) -> None:
    path = tmp_path / "训练.txt"
    replace_text(path, "a ≤ b\n")
    assert path.read_bytes() == "a ≤ b\n".encode()
    assert (read_file(path), read_text(path)) == ("a ≤ b\n".encode(), "a ≤ b\n")


def test_what_utf_8_cannot_write_is_written_as_an_escape(tmp_path: Path) -> None:
    replace_text(tmp_path / "x", "models_\udce8")
    assert read_text(tmp_path / "x") == "models_\\udce8"


def test_what_is_no_regular_file_is_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none", read_file) == "No such file or directory"
    assert refusal(tmp_path, read_file) == "must be a regular file, is a folder"
    assert refusal(Path("a\0b"), read_file) == "embedded null byte"
    with pytest.raises(FileError, match="is a folder"):
        check_regular(tmp_path)
    check_regular(tmp_path / "none")


@pytest.mark.skipif(os.name != "posix", reason="files as POSIX has them")
def test_pipes_sockets_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert refusal(tmp_path / "pipe", read_json) == "must be a regular file, is a named pipe"
    assert refusal(Path("/dev/zero"), read_file) == "must be a regular file, is a device"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "socket"))
        assert refusal(tmp_path / "socket", read_file)


def test_a_file_of_too_many_bytes_is_refused_with_the_limit(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"12345")
    assert read_file(tmp_path / "x", 5) == b"12345"
    assert refusal(tmp_path / "x", read_file, 4) == "must have at most 4 bytes, has 5"


def test_no_handle_is_left_open(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"12345")
    handles = {os.dup(0) for _ in range(2)}
    for handle in handles:
        os.close(handle)
    for _ in range(3):
        read_file(tmp_path / "x")
        refusal(tmp_path / "x", read_file, 1)
        refusal(tmp_path, read_file)
    assert {os.dup(0) for _ in range(2)} == handles
    for handle in handles:
        os.close(handle)


def test_an_error_comes_whole_out_of_another_process() -> None:
    error = pickle.loads(pickle.dumps(FileError(Path("run") / "config.json", "not JSON:\n line 1")))
    assert isinstance(error, FileError)
    assert str(error) == f"{Path('run') / 'config.json'}: not JSON: line 1"


def test_a_reason_is_cut_but_the_path_is_not() -> None:
    path = Path("p" * 200) / ("q" * 200)
    said = str(FileError(path, "r" * 10**6))
    assert said.startswith(f"{path}: rrr")
    assert len(said) == len(f"{path}: ") + MOST_REASON


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not JSON"),
        ("{", "not JSON"),
        ("[1] 2", "not JSON"),
        (b"\xff\xfe[\x00", "not JSON"),
        ("[1]".encode("utf-16"), "not JSON"),
        ("[" * 100_000, "not JSON of at most 64 levels"),
        ("[" * 65 + "]" * 65, "not JSON of at most 64 levels"),
        ('{"a":' * 65 + "1" + "}" * 65, "not JSON of at most 64 levels"),
        ('{"a": {"b": 1, "c": 2, "b": 3}}', "not JSON with every key once: 'b' comes twice"),
        ("NaN", "it must be a finite number, got nan"),
        ('{"a": {"b": [1, -Infinity]}}', "a.b[1] must be a finite number, got -inf"),
        ('{"a": 1e999}', "a must be a finite number, got inf"),
        ('{"a": [%s]}' % ("9" * 5000), "a[0] must have at most 4300 digits, has 5000"),
        ('{"%s": NaN}' % ("k" * 10**5), "kkkkk"),
    ],
)
def test_what_is_no_json_is_refused_in_one_short_line(text: str | bytes, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_json(text)
    said = str(caught.value)
    assert said.startswith(reason)
    assert len(said.splitlines()) == 1
    assert len(said) < 200
    (tmp_path / "x.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    assert refusal(tmp_path / "x.json", read_json) == said


def test_limits_are_reached_but_not_passed() -> None:
    deep = "[" * MOST_NESTED + "]" * MOST_NESTED
    assert json.dumps(parse_json(deep)) == deep
    assert parse_json("9" * MOST_DIGITS) == int("9" * MOST_DIGITS)
    assert parse_json("-" + "9" * 400) == -int("9" * 400)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@given(values)
def test_json_that_python_writes_comes_back_with_its_types(value: object) -> None:
    assert repr(parse_json(json.dumps(value))) == repr(value)
    assert repr(parse_json(json.dumps(value, ensure_ascii=False, indent=2).encode())) == repr(value)


@given(st.text() | st.binary())
def test_any_text_is_read_or_refused(text: str | bytes) -> None:
    try:
        said = f"read: {parse_json(text)!r}"
    except ConfigError as error:
        said = str(error)
    assert len(said.splitlines()) == 1


def test_an_object_must_be_one(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text("[1]")
    assert refusal(tmp_path / "x.json", read_json_object) == "must hold a JSON object, got list"
    (tmp_path / "x.json").write_text('{"a": 1}')
    assert read_json_object(tmp_path / "x.json") == {"a": 1}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "line 1 must name the columns a, b"),
        (b"a,c\n", "line 1 must name the columns a, b"),
        (b"a,b\n1,2\n1\n", "line 3 must have 2 fields of text"),
        (b"a,b\n1,2,3\n", "line 2 must have 2 fields of text"),
        (b"a,b\n\n", "line 2 must have 2 fields of text"),
        (b"a,b\n1,\0\n", "line 2"),
        (b"a,b\n1,\xff\n", "not UTF-8 text: byte 6"),
        (b'a,b\n1,"2"3\n', "line 2: "),
        (b"a,b\n1," + b"2" * 200_000 + b"\n", "line 2: field larger than field limit"),
    ],
)
def test_a_damaged_table_is_refused_with_its_line(data: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(data)
    assert refusal(tmp_path / "x.csv", read_rows, ("a", "b")).startswith(reason)


def test_rows_come_with_their_lines_and_without_a_torn_one(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(b'a,b\r\n1,"2\n2"\r\n3,4\r\n5,')
    rows = read_rows(tmp_path / "x.csv", ("a", "b"))
    assert rows == [(3, {"a": "1", "b": "2\n2"}), (4, {"a": "3", "b": "4"})]


def is_text_unnamed(call: ast.Call) -> bool:
    """Whether a call opens text and leaves the encoding to the locale."""
    name = getattr(call.func, "id", getattr(call.func, "attr", ""))
    if name not in ("open", "fdopen", "read_text", "write_text"):
        return False
    given = [*call.args, *(keyword.value for keyword in call.keywords)]
    modes = [part.value for part in given if isinstance(part, ast.Constant) and isinstance(part.value, str)]
    binary = any("b" in mode and len(mode) <= 3 for mode in modes)
    opens_no_text = name == "open" and getattr(getattr(call.func, "value", None), "id", "") == "os"
    return not binary and not opens_no_text and "encoding" not in {keyword.arg for keyword in call.keywords}


def unnamed(path: Path) -> list[str]:
    """Where a source file opens text without naming its encoding."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    return [f"{path.relative_to(ROOT)}:{call.lineno}" for call in calls if is_text_unnamed(call)]


def test_every_text_that_is_opened_names_its_encoding() -> None:
    sources = [*ROOT.glob("*.py"), *(path for folder in WRITTEN for path in (ROOT / folder).rglob("*.py"))]
    own = ("cad_env/files.py:", "baselines/paper/folder.py:")  # these call `read_text` of cad_env.files, which is UTF-8
    found = [place for path in sources for place in unnamed(path) if not place.startswith(own)]
    assert found == []


def test_an_encoding_that_is_not_named_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    (tmp_path / "x.py").write_text("open('a')\nopen('a', 'rb')\np.read_text()\np.write_text('', encoding='utf-8')\n")
    assert unnamed(tmp_path / "x.py") == ["x.py:1", "x.py:3"]
