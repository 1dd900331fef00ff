"""What is wrong with a study, in the user's words: every mistake with its path, value and cure."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from pydantic import ValidationError


class _Absent:
    """Stands for a value that is not there (None is a value)."""

    def __repr__(self) -> str:
        return "nothing"


ABSENT: Any = _Absent()


class Mistake(NamedTuple):
    """One thing to mend in a study."""

    path: str  # as the user writes it: devices[0].EA
    value: Any  # what stands there, or ABSENT
    problem: str  # what is wrong and what is allowed
    remedy: str = ""  # what to do, where that is more than the problem says

    def __str__(self) -> str:
        value = "" if self.value is ABSENT else f" = {_short(self.value)}"
        return f"{self.path}{value}: {self.problem}" + (f"; {self.remedy}" if self.remedy else "")


class ConfigError(ValueError):
    """A study that cannot be run as written; ``mistakes`` holds all that was found."""

    def __init__(self, mistakes: Iterable[Mistake], source: str = "") -> None:
        self.mistakes = list(mistakes)
        self.source = source
        super().__init__(str(self))

    def __str__(self) -> str:
        n = len(self.mistakes)
        head = f"{self.source or 'the study'} has {n} mistake{'s' if n != 1 else ''}:"
        return "\n".join([head, *(f"  {mistake}" for mistake in self.mistakes)])

    def __reduce__(self) -> tuple[Any, ...]:
        return (ConfigError, (self.mistakes, self.source))


def _short(value: Any, limit: int = 60) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    text = " ".join(text.split())
    return text if len(text) <= limit else text[: limit - 3] + "..."


def closest(word: Any, allowed: Iterable[str], cutoff: float = 0.5) -> str | None:
    """The allowed word most like this one, capitals ignored; None where none is."""
    lowered = {name.lower(): name for name in allowed}
    match = difflib.get_close_matches(str(word).lower(), lowered, n=1, cutoff=cutoff)
    return lowered[match[0]] if match else None


def nearest(word: Any, allowed: Iterable[str]) -> str:
    """``did you mean ...?`` and what is allowed, for a key or name that does not exist."""
    names = list(allowed)
    match = closest(word, names)
    hint = f"did you mean `{match}`? " if match else ""
    return f"{hint}allowed: {', '.join(names)}" if names else hint.strip()


def join(parts: Sequence[str | int]) -> str:
    """A path as users write it: ``("devices", 0, "EA")`` is ``devices[0].EA``."""
    text = ""
    for part in parts:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else str(part)
    return text


# --------------------------------------------------------------------------- pydantic's errors, translated

_WORDING = (
    (r"^Value error, ", ""),
    (r"^Input should be", "should be"),
    (r", unable to parse string as an? \w+$", ""),
    (r"a (valid )?dictionary( or an instance of \w+)?", "a mapping of keys to values"),
    (r"a valid (tuple|list)", "a list"),
    (r"a valid string", "text"),
    (r"a valid integer", "a whole number"),
    (r"a valid ", "a "),
    (r"^(Tuple|List|Value|Set) should have", "should have"),
    (r" after validation, not \d+$", ""),
)


class Fault(NamedTuple):
    """One of pydantic's errors: the mistake, where it is, and what it compares."""

    mistake: Mistake
    at: tuple[str | int, ...]  # the value at fault, or the model whose fields contradict one another
    sentence: str = ""  # what the model's validator says; '' where a single value is at fault
    field: tuple[str | int, ...] = ()  # the model's field that is to be changed, from the model


# What the validators of the vocabulary say: the field at fault, and the cure. A sentence that is not listed is
# put at the field that it begins with, or at the model.
_CURES = (
    (
        r"s = \S+ m with its rod (is off the cable .*)",
        "s",
        "move the device, shorten its rod or lengthen the cable",
    ),
    (r"(a rod must leave cable .*)", "s", "move the device inward or shorten its `rod`"),
    (
        r"(devices\[\d+\]) and (devices\[\d+\]) are at the same place: .*",
        "",
        "move one of them along the cable",
    ),
    (r"(a cable with two free ends has no static start).*", "start.kind", "use kind `given` or `released`"),
    (r"(a released start needs .*)", "start.kind", "give each free end a `position`, or use another kind"),
    (r"(`seabed.z` must be minus `water.depth`)", "seabed.z", "change either, or leave `water.depth` out"),
    (r"(a \w+ end needs a `position`)", "position", "write `position: [x, y, z]`"),
    (r"(only a free end takes a `force`)", "force", "remove it, or use `kind: free`"),
    (r"(a free end cannot have a `motion`)", "motion", "remove it, or use another `kind`"),
    (r"(a clamped end needs a `direction`)", "direction", "write the way in which s increases there: [x, y, z]"),
    (
        r"(a pinned end has no `direction`): `clamped` holds it, `free` with a `direction` guides it",
        "direction",
        "use `kind: clamped`, which holds it, or `free`, which is guided along it; or remove it",
    ),
    (r"(a `moment` on an end that cannot turn does nothing)", "moment", "remove it, or the `direction`"),
    (r"(`twist` needs a `direction` to turn about)", "twist", "give the end a `direction`, or remove the twist"),
    (r"(`direction` must not be zero)", "direction", "write the way in which s increases there: [x, y, z]"),
    (r"(`coupling` squared must be below EA GJ, .*)", "coupling", "lower it, or raise `GJ`"),
    (
        r"(`EI2`, `GJ`, `coupling` and `curvature` need an `EI` above 0)",
        "EI",
        "give the bending stiffness, or remove them",
    ),
    (r"(`rods` must be stretches .*)", "rods", "write e.g. `rods: [[0, 10], [90, 100]]`"),
    (r"(`t` has .*, `angle` has .*)", "", "one entry for each, in increasing order"),
    (r"(`stop - start` must be .*)", "stop", "stop later or shorten the ramps"),
    (r"(`stochastic` needs a `window` .*)", "window.stop", "write when it ends [s]"),
    (r"(give `volume` or `wet_weight`.*)", "wet_weight", "remove one of them"),
    (r"(a free device is held by `cords`)", "law", "write `law: cords`, or use `kind: bnes`"),
    (r"(`rod: cords` is .*)", "rod", ""),
    (r"(`t` has .*|`z` has .*|`\w` must increase)", "", "one entry for each, in increasing order"),
    (r"(`shape` belongs to .*)", "shape", "write `kind: given` and `shape: [[x, y, z], ...]`, or neither"),
    (r"(`values` and `file` belong .*)", "", "write `kind: given`, or remove them"),
    (r"(`(?:n|levels)` .*)", "", "e.g. {kind: sobol, n: 100} or {kind: grid, n: 5}"),
)


def translate(error: ValidationError, raw: Any, prefix: str, schema: dict[str, Any]) -> list[Mistake]:
    """Pydantic's list of errors as mistakes; see :func:`faults`."""
    return [fault.mistake for fault in faults(error, raw, prefix, schema)]


def faults(error: ValidationError, raw: Any, prefix: str, schema: dict[str, Any]) -> list[Fault]:
    """Pydantic's list of errors, with the discriminator tags of unions left out of the paths.

    Parameters
    ----------
    error : what pydantic raised on ``raw``
    prefix : path of ``raw`` in the study, e.g. ``scene``
    schema : JSON schema of what was expected; names the allowed keys
    """
    found: dict[str, Fault] = {}
    for item in sorted(error.errors(include_url=False), key=lambda item: item["type"] == "too_short"):
        parts, value = _locate(item["loc"], raw, item["type"])
        for fault in _one(item, parts, value, raw, prefix, schema):
            mistake = fault.mistake
            old = found.get(mistake.path)
            if item["type"] == "too_short" and value and any(path.startswith(mistake.path) for path in found):
                continue  # only because its entries are wrong
            if old is None:
                found[mistake.path] = fault
            elif "a rod must leave cable" in fault.sentence and "off the cable" in old.sentence:
                continue  # the same said twice
            elif (
                mistake.problem not in old.mistake.problem
            ):  # another alternative of a union, or another fault
                word = ", or " if mistake.problem.startswith("should be") else "; "
                found[mistake.path] = old._replace(
                    mistake=old.mistake._replace(
                        problem=f"{old.mistake.problem}{word}{mistake.problem}",
                        remedy=old.mistake.remedy or mistake.remedy,
                    )
                )
    return list(found.values())


def _locate(loc: Sequence[str | int], raw: Any, kind: str) -> tuple[list[str | int], Any]:
    parts: list[str | int] = []
    here = raw
    for i, element in enumerate(loc):
        if isinstance(here, dict):
            if element in here:
                here = here[element]
            elif kind == "missing" and i == len(loc) - 1:
                here = ABSENT
            else:
                continue  # the tag of a union
        elif isinstance(here, list | tuple) and isinstance(element, int):
            here = here[element] if element < len(here) else ABSENT
        else:
            continue  # an alternative of a union
        parts.append(element)
    return parts, here


def named(prefix: str, parts: Sequence[str | int]) -> str:
    """The path of a part of a section, as users write it."""
    tail = join(parts)
    return tail if not prefix else prefix + (tail if tail.startswith("[") or not tail else f".{tail}")


def unknown_key(path: str, value: Any, key: Any, keys: Iterable[str]) -> Mistake:
    return Mistake(path, value, "unknown key", nearest(key, keys))


def unknown_kind(path: str, given: Any, tags: Iterable[str]) -> Mistake:
    return Mistake(path, given, "is required" if given is ABSENT else "unknown kind", nearest(given, tags))


def _one(
    item: Any, parts: list[str | int], value: Any, raw: Any, prefix: str, schema: dict[str, Any]
) -> list[Fault]:
    kind = item["type"]
    path = named(prefix, parts)
    if kind == "value_error" and isinstance(value, dict):
        return [
            _cross(sentence, parts, value, prefix)
            for sentence in re.split(r"; (?!give )", _worded(item["msg"]))
        ]
    if kind == "missing":
        mistake = Mistake(path, ABSENT, "is required")
    elif kind in ("unexpected_keyword_argument", "extra_forbidden"):
        mistake = unknown_key(path, value, parts[-1], keys_of(schema_at(schema, parts[:-1], raw)))
    elif kind in ("union_tag_invalid", "union_tag_not_found"):
        given = value.get("kind", ABSENT) if isinstance(value, dict) else ABSENT
        tags = tags_of(schema_at(schema, parts, raw, choose=False))
        mistake = unknown_kind(named(prefix, [*parts, "kind"]), given, tags)
    elif kind == "literal_error":
        allowed = re.findall(r"'([^']*)'", item["ctx"]["expected"]) or [item["ctx"]["expected"]]
        mistake = Mistake(path, value, "should be one of the allowed words", nearest(value, allowed))
    else:
        mistake = Mistake(path or prefix, value, _worded(item["msg"]))
    return [Fault(mistake, tuple(parts))]


def _worded(text: str) -> str:
    for pattern, replacement in _WORDING:
        text = re.sub(pattern, replacement, text)
    return text


def _cross(sentence: str, parts: list[str | int], model: dict[str, Any], prefix: str) -> Fault:
    """What the validator of a model says, at the field that is at fault."""
    at = re.match(r"^(\w+)\[(\d+)\]: (.*)$", sentence)  # the scene's validator says which device
    inner: list[str | int] = [at[1], int(at[2])] if at else []
    problem, field, remedy = at[3] if at else sentence, "", ""
    for pattern, name, cure in _CURES:
        match = re.fullmatch(pattern, problem)
        if match is None:
            continue
        problem, field, remedy = match[1], name, cure
        if len(match.groups()) == 2:  # two devices
            inner, field = ["devices", int(match[2][8:-1])], "s"
            problem = f"is at the same place as `{match[1]}`: their mounts must not touch"
        break
    leading = re.match(r"`(\w+)(: \[.*\])?` ", problem)
    if not field and leading:
        field = leading[1]
    inner += field.split(".") if field else []
    value: Any = model
    for part in inner:
        if isinstance(part, int):
            value = value[part] if isinstance(value, list | tuple) and part < len(value) else ABSENT
        else:
            value = value.get(part, ABSENT) if isinstance(value, dict) else ABSENT
    value = ABSENT if not inner or isinstance(value, dict) else value
    return Fault(
        Mistake(named(prefix, [*parts, *inner]), value, problem, remedy), tuple(parts), sentence, tuple(inner)
    )


# --------------------------------------------------------------------------- what a JSON schema allows


def schema_at(
    schema: dict[str, Any], parts: Sequence[str | int], raw: Any, choose: bool = True
) -> dict[str, Any]:
    """Follow a path through a JSON schema, choosing alternatives by what ``raw`` holds."""
    defs = schema.get("$defs", {})
    node = resolve(schema, raw, defs) if choose or parts else schema
    here = raw
    for i, part in enumerate(parts):
        if isinstance(part, int):
            items = node.get("prefixItems")
            node = items[part] if items and part < len(items) else node.get("items", {})
            here = here[part] if isinstance(here, list | tuple) and part < len(here) else ABSENT
        else:
            node = node.get("properties", {}).get(part) or node.get("additionalProperties", {})
            here = here.get(part, ABSENT) if isinstance(here, dict) else ABSENT
        if not isinstance(node, dict):
            return {}
        if choose or i < len(parts) - 1:
            node = resolve(node, here, defs)
    return node


def resolve(node: dict[str, Any], here: Any, defs: dict[str, Any]) -> dict[str, Any]:
    """The schema that applies to what is here: references followed, the alternative of a union chosen."""
    while True:
        if "$ref" in node:
            node = defs[node["$ref"].rsplit("/", 1)[1]]
            continue
        mapping = node.get("discriminator", {}).get("mapping")
        if mapping and isinstance(here, dict) and here.get("kind") in mapping:
            node = {"$ref": mapping[here["kind"]]}
            continue
        options = node.get("anyOf") or node.get("oneOf")
        if not options:
            return node
        resolved = [resolve(option, here, defs) for option in options]
        wanted = "properties" if isinstance(here, dict) else "items"
        return next((o for o in resolved if wanted in o or "prefixItems" in o), resolved[0])


def keys_of(node: dict[str, Any]) -> list[str]:
    return list(node.get("properties", {}))


def tags_of(node: dict[str, Any]) -> list[str]:
    return list(node.get("discriminator", {}).get("mapping", {}))
