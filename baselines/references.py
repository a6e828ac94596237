"""Objects from outside that a command names: `module:attribute`, or `module:factory(argument=value)`."""

import ast
import os
import re
import sys
from importlib import import_module
from typing import Any

from cad_env.checks import did_you_mean

_FORM = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)(?P<call>\(.*\))?", re.DOTALL)


def is_reference(text: str) -> bool:
    """Whether a name is that of an object from outside."""
    return ":" in text


def resolved(text: str) -> Any:
    """The object; a class is called without arguments if none are given. ValueError, one line, if there is none.

    Modules are looked for in the current folder too. Arguments are literals: nothing else is evaluated.

    >>> resolved("fractions:Fraction(numerator=1, denominator=2)")
    Fraction(1, 2)
    >>> resolved("fractions:Fractoin")
    Traceback (most recent call last):
    ValueError: 'fractions:Fractoin': fractions has no 'Fractoin'; did you mean Fraction?
    """
    form = _FORM.fullmatch(text)
    if form is None:
        raise ValueError(f"{text!r} must be module:name or module:name(argument=value)")
    module = _module(text, form["module"])
    if not hasattr(module, form["name"]):
        near = did_you_mean(form["name"], [name for name in dir(module) if not name.startswith("_")])
        raise ValueError(f"{text!r}: {form['module']} has no {form['name']!r}{near}")
    found = getattr(module, form["name"])
    if form["call"] is None and not isinstance(found, type):
        return found
    positional, named = _arguments(text, form["call"] or "()")
    try:
        return found(*positional, **named)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{text!r}: {error}") from None


def module_source(text: str) -> bytes:
    """The source of the module that a name is of: what an object from outside does may change with it."""
    path = _module(text, text.partition(":")[0]).__file__
    if path is None:
        return b""
    with open(path, "rb") as file:
        return file.read()


def _module(text: str, name: str) -> Any:
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # last, so that a file there shadows no installed module; workers take it over
    try:
        return import_module(name)
    except (ImportError, SyntaxError) as error:
        raise ValueError(f"{text!r}: {error}") from None


def _arguments(text: str, call: str) -> tuple[list[Any], dict[str, Any]]:
    try:
        tree = ast.parse(f"f{call}", mode="eval").body
        if not isinstance(tree, ast.Call) or any(keyword.arg is None for keyword in tree.keywords):
            raise ValueError
        named = {str(keyword.arg): ast.literal_eval(keyword.value) for keyword in tree.keywords}
        return [ast.literal_eval(value) for value in tree.args], named
    except (ValueError, SyntaxError):
        raise ValueError(f"{text!r}: arguments must be literals, such as (seconds=0.5)") from None
