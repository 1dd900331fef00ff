"""Field paths (``devices[0].EA``), the arithmetic of tied variables, and binding values into a scene."""

from __future__ import annotations

import ast
import copy
import functools
import math
import operator
import re
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import TypeAdapter

from solvers import Scene

from .mistakes import ABSENT, join, keys_of, nearest, schema_at

SCENE: TypeAdapter[Any] = TypeAdapter(Scene)
ASK = "ask."  # what begins the path of a field of the ask; the scene has no field of that name
COUNT = "devices.count"  # no field of the scene: how many of its devices there are, the first ones
_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[(\d+)\]")


class FieldError(ValueError):
    """A path or expression that means nothing here; ``remedy`` says what would."""

    def __init__(self, problem: str, remedy: str = "") -> None:
        super().__init__(problem)
        self.problem = problem
        self.remedy = remedy


def parse(path: str) -> tuple[str | int, ...]:
    """``devices[0].EA`` as ``("devices", 0, "EA")``."""
    parts: list[str | int] = []
    at = 0
    while at < len(path):
        step = _STEP.match(path, at)
        if step is None:
            break
        parts.append(step[1] if step[1] is not None else int(step[2]))
        at = step.end()
    if at < len(path) or not parts or isinstance(parts[0], int):
        raise FieldError("is not a field path", "write it like `devices[0].EA` or `end_b.position[2]`")
    return tuple(parts)


def lookup(tree: Any, path: str) -> Any:
    """The value at a path of a dumped scene; FieldError says where the path leaves the scene.

    ABSENT where the path leads into a part of the scene that is not known.
    """
    here = tree
    done: list[str | int] = []
    for part in parse(path):
        if here is ABSENT:
            return ABSENT
        where = join(done) or "the scene"
        if isinstance(part, int):
            if not isinstance(here, list):
                raise FieldError(f"`{where}` is not a list")
            if part >= len(here):
                count = f"entries 0 to {len(here) - 1}" if here else "no entries"
                raise FieldError(f"`{where}` has {count}")
        elif not isinstance(here, dict):
            place = "study" if done and done[0] == "ask" else "scene"
            given = f"is not given in the {place}" if here is None else "has no fields"
            raise FieldError(f"`{where}` {given}")
        elif part not in here:
            raise FieldError(f"`{where}` has no field `{part}`", nearest(part, here))
        here = here[part]
        done.append(part)
    return here


def assign(tree: Any, path: str, value: Any) -> None:
    """Set a value in a dumped scene; whole numbers stay whole where the scene has whole numbers."""
    *head, last = parse(path)
    here = tree
    for part in head:
        here = here[part]
    old = here[last]
    if isinstance(old, int) and not isinstance(old, bool) and isinstance(value, float) and value.is_integer():
        value = int(value)
    here[last] = value


def apart(values: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Values at field paths of the scene, and those of the ask without their ``ask.``."""
    scene = {path: value for path, value in values.items() if not path.startswith(ASK)}
    return scene, {path.removeprefix(ASK): value for path, value in values.items() if path.startswith(ASK)}


def dump(scene: Scene) -> dict[str, Any]:
    """A scene as plain nested lists and dicts, defaults included."""
    return SCENE.dump_python(scene, mode="json")


def place(tree: dict[str, Any], values: Mapping[str, Any], strict: bool = True) -> None:
    """Set values at paths of a dumped scene or ask, whole parts before what is inside them.

    A mapping is laid over what stands there: fields that it does not give stay, as far as a part of its `kind` has
    them. Nothing (None) in place of a device takes it away, and ``devices.count`` keeps the first devices. A path into
    a part that one of the values has made another, or taken away, is idle.

    Raises FieldError for any other path that leads nowhere; not strict leaves such paths out.
    """
    whole: list[tuple[str | int, ...]] = []
    for path, parts in sorted(((path, parse(path)) for path in values if path != COUNT), key=lambda item: len(item[1])):
        try:
            lookup(tree, path)
        except FieldError:
            if strict and not any(parts[: len(outer)] == outer for outer in whole):
                raise
            continue
        if isinstance(values[path], Mapping):
            _lay(tree, path, values[path])
        else:
            assign(tree, path, values[path])
        whole.append(parts)
    if isinstance(tree.get("devices"), list):
        count = values.get(COUNT)
        first = tree["devices"][: None if count is None else int(count)]
        tree["devices"] = [device for device in first if device is not None]


def _lay(tree: Any, path: str, value: Mapping[str, Any]) -> None:
    """Lay a mapping over a part of a dumped scene."""
    *head, last = parts = parse(path)
    here = tree
    for part in head:
        here = here[part]
    kept = here[last] if isinstance(here[last], Mapping) else {}
    here[last] = {**kept, **value}
    allowed = keys_of(schema_at(_schema(), parts, tree))
    here[last] = {key: item for key, item in here[last].items() if key in value or not allowed or key in allowed}


def kind_has(tree: Any, path: str, value: Mapping[str, Any], inner: str | int) -> bool:
    """Whether a part of a scene, once a mapping is laid over it, has a field."""
    tree = copy.deepcopy(tree)
    _lay(tree, path, value)
    return inner in keys_of(schema_at(_schema(), parse(path), tree))


@functools.cache
def _schema() -> dict[str, Any]:
    return SCENE.json_schema()


def bind(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with values set at field paths (:func:`place`), validated."""
    if not values:
        return scene
    tree = dump(scene)
    place(tree, values)
    return SCENE.validate_python(tree)


def deep_merge(base: Any, over: Any) -> Any:
    """``over`` on top of ``base``: mappings key by key, anything else (lists too) replaced whole."""
    if not isinstance(base, dict) or not isinstance(over, dict):
        return over
    return base | {key: deep_merge(base[key], value) if key in base else value for key, value in over.items()}


# --------------------------------------------------------------------------- expressions

_BINARY: dict[type, Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "sqrt": math.sqrt,
    "log": math.log,
    "exp": math.exp,
    "min": min,
    "max": max,
}
_CONSTANTS = {"pi": math.pi}


class Expression:
    """Arithmetic on design variables: numbers, + - * / **, sqrt, log, exp, min, max, pi. Nothing else runs.

    A variable whose key is a field path is named by that path: ``sqrt(0.002 * devices[0].EA)``.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self._body = ast.parse(text.strip(), mode="eval").body
            self.names = frozenset(self._check(self._body))
        except (SyntaxError, RecursionError, MemoryError, ValueError) as error:
            if isinstance(error, FieldError):
                raise
            raise FieldError(
                "is not arithmetic", "numbers, variables, + - * / **, sqrt, log, exp, min, max, pi"
            ) from None

    def _check(self, node: ast.expr) -> set[str]:
        match node:
            case ast.Constant(value=int() | float()) if not isinstance(node.value, bool):
                return set()
            case ast.BinOp() if type(node.op) in _BINARY:
                return self._check(node.left) | self._check(node.right)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                return self._check(node.operand)
            case ast.Name():
                return set() if node.id in _CONSTANTS else {node.id}
            case ast.Attribute() | ast.Subscript():
                return {ast.unparse(node)}
            case ast.Call(func=ast.Name(), keywords=[]) if node.args:
                if node.func.id not in _FUNCTIONS:  # type: ignore[attr-defined]
                    name = node.func.id  # type: ignore[attr-defined]
                    raise FieldError(f"unknown function `{name}`", nearest(name, _FUNCTIONS))
                return set().union(*map(self._check, node.args))
        raise FieldError(
            f"`{ast.unparse(node)}` is not allowed in an expression",
            "numbers, variables, + - * / **, sqrt, log, exp, min, max, pi",
        )

    def value(self, names: Mapping[str, float]) -> float:
        """The value for these design variables; FieldError where it is not a finite real number."""
        try:
            result = self._evaluate(self._body, names)
        except (ArithmeticError, ValueError, TypeError) as error:
            raise FieldError(f"cannot be evaluated: {error}") from None
        if isinstance(result, complex) or not math.isfinite(result):
            raise FieldError("is not a finite real number")
        return float(f"{result:.12g}")  # the last bits differ between math libraries; keys must not

    def _evaluate(self, node: Any, names: Mapping[str, float]) -> float:
        match node:
            case ast.Constant(value=int() | float() as number):
                return float(number)
            case ast.BinOp():
                return _BINARY[type(node.op)](
                    self._evaluate(node.left, names), self._evaluate(node.right, names)
                )
            case ast.UnaryOp():
                value = self._evaluate(node.operand, names)
                return -value if isinstance(node.op, ast.USub) else value
            case ast.Call():
                return _FUNCTIONS[ast.unparse(node.func)](*(self._evaluate(arg, names) for arg in node.args))
            case ast.Name() if node.id in _CONSTANTS:
                return _CONSTANTS[node.id]
        return names[ast.unparse(node)]


__all__ = [
    "ABSENT",
    "Expression",
    "FieldError",
    "apart",
    "assign",
    "bind",
    "deep_merge",
    "dump",
    "lookup",
    "parse",
    "place",
]
