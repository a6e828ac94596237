"""Commands find their packages, and name the extra that is missing in one line."""

import sys

import pytest

from cad_env import commands

COMMANDS = (commands.train, commands.evaluate, commands.reproduce, commands.demo)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.__name__)
def test_every_command_has_help(
    command: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["cad", "--help"])
    assert callable(command)
    with pytest.raises(SystemExit) as stop:
        command()
    assert stop.value.code == 0
    assert "usage" in capsys.readouterr().out


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.__name__)
@pytest.mark.parametrize("missing", ["baselines", "tyro"])
def test_a_missing_extra_is_named_in_one_line(
    command: object, missing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "baselines"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    monkeypatch.setattr(sys, "argv", ["cad", "--help"])
    assert callable(command)
    assert command() == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert "pip install 'cad-env[learning]'" in said
    assert said.count("\n") == 1


def test_a_module_of_the_users_own_is_not_blamed_on_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def main() -> int:
        raise ModuleNotFoundError("No module named 'mine'", name="mine")

    monkeypatch.setattr("baselines.demo.main", main)
    with pytest.raises(ModuleNotFoundError, match="mine"):
        commands.demo()
