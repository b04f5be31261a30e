"""Errors of a command's arguments as one line: the argument, what was given, what is expected, an example.

The example is that of the command, the last line of its help.
"""

from __future__ import annotations

import re
from typing import Any

EXAMPLE = "Example: "
"""The beginning of an example in a command's epilog."""
_BOUNDS = {
    "greater_than_equal": ("ge", "from {} on"),
    "greater_than": ("gt", "above {}"),
    "less_than_equal": ("le", "up to {}"),
    "less_than": ("lt", "below {}"),
}
"""Pydantic's kinds of a number out of its range: the field that has the bound, and the words for it."""
_EXTRA = re.compile(r"Got unexpected extra arguments?(?:\(s\))? \((.*)\)$")
"""Typer's message about more arguments than a command takes."""
_ANY_NUMBER = {"int_parsing": 10, "float_parsing": 1.5}
"""An example of a number whose option has neither a bound nor a default."""


def usage_line(error: Any) -> str:
    """One line for an error of typer's about a command's arguments."""
    context, parameter, kind = getattr(error, "ctx", None), getattr(error, "param", None), type(error).__name__
    if kind == "BadOptionUsage":
        return f"{error.option_name}: expected a value after it"
    if kind == "NoArgsIsHelpError" and context is not None:
        names = ", ".join(getattr(context.command, "commands", {}))
        return f"{context.command_path}: expected a command: {names}; `{context.command_path} --help` describes them"
    if parameter is None:
        return _line_without_parameter(error, context)
    name, problem = _name_of(parameter), _pydantic_problem(error)
    if kind == "MissingParameter":
        line = f"{name} is missing"
    else:
        line = f"{name}: {error.message if problem is None else _expectation(problem)}"
    shown = _example_for(parameter, context, problem)
    return f"{line}; for example: {shown}" if shown else line


def _line_without_parameter(error: Any, context: Any) -> str:
    """The line of an error that belongs to several options, or to none that exists."""
    hint = getattr(error, "param_hint", None)
    if hint is not None:
        return f"{hint if isinstance(hint, str) else ' and '.join(hint)}: {error.message}"
    line = str(error.format_message()).removeprefix("Invalid value: ")
    extra = _EXTRA.match(line)
    if extra is not None and context is not None:
        return f"{extra[1]}: {_arity(context, extra[1])}"
    if context is None or not line.startswith("No such") or line.endswith(("?", ")")):  # these have a suggestion
        return line
    return f"{line.rstrip('.')}; `{context.command_path} --help` lists what there is"


def _arity(context: Any, extra: str) -> str:
    """How many arguments a command takes, and what the superfluous ones may have been meant for."""
    parameters = context.command.params
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    counted = [f"{'one' if p.required else 'at most one'} {_name_of(p)}" for p in arguments]
    takes = f"`{context.command_path}` takes {' and '.join(counted) or 'no argument'}"
    if [_name_of(p) for p in arguments] in (["RUN"], ["RECORDING"]):
        return f"{takes}; `fluxbench compare RUN RUN...` compares several"
    if "=" in extra and any("--set" in p.opts for p in parameters):
        return f"{takes}; a setting is given as `--set {extra}`"
    return f"{takes}; `{context.command_path} --help` lists its options"


def _name_of(parameter: Any) -> str:
    """How the user writes an option, or how the usage names an argument."""
    if parameter.param_type_name == "option":
        return str(max(parameter.opts, key=len))
    return str(parameter.metavar or parameter.name).strip("{}").upper().split("...")[0]


def _pydantic_problem(error: BaseException) -> dict[str, Any] | None:
    """The first problem of the validation that raised the error; None where none did."""
    from pydantic import ValidationError

    cause = error.__cause__
    return dict(cause.errors(include_url=False)[0]) if isinstance(cause, ValidationError) else None


def _expectation(problem: dict[str, Any]) -> str:
    """What is expected and what was given, of a problem of pydantic's."""
    from orchestrator.validation.messages import describe_problem

    if problem["type"] not in _BOUNDS:
        return describe_problem(problem)
    field, words = _BOUNDS[problem["type"]]
    return f"expected a number {words.format(_plain(problem['ctx'][field]))}, got {problem['input']!r}"


def _example_for(parameter: Any, context: Any, problem: dict[str, Any] | None) -> str:
    """The command's example where it shows the parameter, else the option with a number; empty without either."""
    epilog = str(getattr(getattr(context, "command", None), "epilog", None) or "")
    command = epilog.removeprefix(EXAMPLE) if epilog.startswith(EXAMPLE) else ""
    if parameter.param_type_name != "option" or any(option in command.split() for option in parameter.opts):
        return command
    if problem is None:
        return ""
    default, kind = parameter.default, problem["type"]
    number = default if isinstance(default, int | float) else problem.get("ctx", {}).get("ge", _ANY_NUMBER.get(kind))
    return "" if number is None else f"{_name_of(parameter)} {_plain(number)}"


def _plain(number: float) -> str:
    """A bound as one would write it: 0 instead of 0.0."""
    return f"{number:g}" if isinstance(number, float) else str(number)
