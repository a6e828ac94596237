"""A folder says what it was made with, and is used for nothing else."""

from pathlib import Path

import pytest

from baselines.folder_note import claim
from cad_env.files import FileError, read_json_object

ADVICE = "use another folder"


def test_the_same_settings_claim_a_folder_again_whatever_type_they_had(tmp_path: Path) -> None:
    path = tmp_path / "new" / "note.json"
    claim(path, {"seeds": (0, 1), "depth": 15}, ADVICE)
    before = path.read_bytes()
    claim(path, {"depth": 15, "seeds": [0, 1]}, ADVICE)
    assert path.read_bytes() == before
    assert read_json_object(path) == {"seeds": [0, 1], "depth": 15}


def test_only_the_command_may_differ(tmp_path: Path) -> None:
    path = tmp_path / "note.json"
    claim(path, {"depth": 15, "command": "one"}, ADVICE)
    claim(path, {"depth": 15, "command": "two"}, ADVICE)
    for wanted, change in (
        ({"depth": 2}, r"another depth \(15, now 2\)"),
        ({"depth": 15, "loss": 0.1}, "another loss"),
    ):
        with pytest.raises(ValueError, match=f"holds a run with {change}.*: use another folder"):
            claim(path, wanted, ADVICE)


@pytest.mark.parametrize(
    ("text", "reason"),
    [("{", "not JSON"), ("[]", "must hold a JSON object, got list"), ("", "not JSON"), ("[" * 5000, "64 levels"),
     ('{"a": ' * 80 + "1" + "}" * 80, "64 levels"), ('{"seed": 1, "seed": 2}', "'seed' comes twice"),
     ('{"seed": 1e999}', "seed must be a finite number")],
)  # fmt: skip
def test_a_damaged_note_is_named_and_kept(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "note.json"
    path.write_text(text)
    with pytest.raises(FileError, match=f"^{path}: .*{reason}.*: use another folder$"):
        claim(path, {"depth": 15}, ADVICE)
    assert path.read_text() == text
