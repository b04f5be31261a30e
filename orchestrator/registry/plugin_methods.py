"""Checks that a plugin's class has the methods of its contract, with compatible signatures."""

from __future__ import annotations

import inspect
from typing import Any

from orchestrator.validation.messages import nearest
from protocols import EFFECT_HOOKS, FORMER_HOOKS, Effect


def method_problem(plugin: type[Any], method: str, contract: type[Any], declared_as: str = "") -> str | None:
    """Why a plugin's method cannot be called as its contract declares it, in a few words; None where it can.

    Parameters
    ----------
    plugin : type
        The plugin's class.
    method : str
        The method's name.
    contract : type
        The protocol or base class that declares it.
    declared_as : str
        Its name there, where the plugin uses a former one.
    """
    found = getattr(plugin, method, None)
    arguments = list(inspect.signature(getattr(contract, declared_as or method)).parameters)
    if not callable(found):
        return f"is missing: write def {method}({', '.join(arguments)}){misspelling(plugin, method, contract)}"
    passed = arguments[1:]
    try:
        # A plain function of the class is not bound yet.
        bound = isinstance(inspect.getattr_static(plugin, method), staticmethod | classmethod)
        inspect.signature(found).bind(*(passed if bound else arguments))
    except TypeError:
        return f"cannot be called as {method}({', '.join(passed)})"
    except ValueError:
        return None  # written in another language, and without a signature
    return None


def misspelling(plugin: type[Any], name: str, contract: type[Any]) -> str:
    """Which attribute of a plugin's class is probably meant as a missing one; empty where none is like it."""
    declared = {*dir(contract), *inspect.get_annotations(contract)}
    near = nearest(name, [own for own in dir(plugin) if not own.startswith("_") and own not in declared])
    return "" if near is None else f"; the class has {near!r}: did you mean {name!r}?"


def hook_problem(plugin: type[Any]) -> str | None:
    """The first public method of an effect's class that would never be called, or with other arguments.

    Attributes that cannot be called, nested classes and names that begin with an underscore are the effect's own.

    Returns
    -------
    str or None
        In one line; None where each public method is one of `Effect` or of `protocols.EFFECT_HOOKS`.
    """
    required = [name for name, member in vars(Effect).items() if inspect.isfunction(member) and name[0] != "_"]
    known = [*required, *EFFECT_HOOKS]
    for name in dir(plugin):
        member = getattr(plugin, name, None)
        is_known = name in known or name in FORMER_HOOKS
        if not name.startswith("_") and not is_known and callable(member) and not inspect.isclass(member):
            near = nearest(name, known)
            meant = f"did you mean {near!r}?" if near else "a method of its own begins with an underscore"
            return f"method {name!r} is never called: an effect has {', '.join(known)}; {meant}"
    for hook, today in (*((hook, hook) for hook in EFFECT_HOOKS), *FORMER_HOOKS.items()):
        if getattr(plugin, hook, None) is None:
            continue
        if hook != today and getattr(plugin, today, None) is not None:
            return f"method {hook!r} is the former name of {today!r}, and the effect has both"
        problem = method_problem(plugin, hook, EFFECT_HOOKS[today], today)
        if problem is not None:
            return f"method {hook!r} {problem}"
    return None
