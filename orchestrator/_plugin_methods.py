"""Checks that a plugin's class has the methods of its contract, with compatible signatures."""

from __future__ import annotations

import inspect
from typing import Any

from orchestrator._validation import nearest
from protocols import EFFECT_HOOKS, Effect


def method_problem(plugin: type[Any], method: str, contract: type[Any]) -> str | None:
    """The reason why a plugin's method cannot be called as its contract declares it; None where it can.

    Parameters
    ----------
    plugin : type
        The plugin's class.
    method : str
        The method's name.
    contract : type
        The protocol or base class that declares it.
    """
    candidate = getattr(plugin, method, None)
    arguments = list(inspect.signature(getattr(contract, method)).parameters)
    if not callable(candidate):
        return f"is missing: write def {method}({', '.join(arguments)})"
    passed = arguments[1:]
    try:
        # A plain function of the class is not bound yet.
        bound = isinstance(inspect.getattr_static(plugin, method), staticmethod | classmethod)
        inspect.signature(candidate).bind(*(passed if bound else arguments))
    except TypeError:
        return f"cannot be called as {method}({', '.join(passed)})"
    except ValueError:
        return None  # written in another language, and without a signature
    return None


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
        if not name.startswith("_") and name not in known and callable(member) and not inspect.isclass(member):
            near = nearest(name, known)
            hint = f"did you mean {near!r}?" if near else "a method of its own begins with an underscore"
            return f"method {name!r} is never called: an effect has {', '.join(known)}; {hint}"
    for hook, contract in EFFECT_HOOKS.items():
        member = getattr(plugin, hook, None)
        problem = None if member is None else method_problem(plugin, hook, contract)
        if problem is not None:
            return f"method {hook!r} {problem}"
    return None
