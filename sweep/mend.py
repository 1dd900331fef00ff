"""Reading on past a mistake: what a section with mistakes says that can still be relied on.

A mistake must not hide another. So a section that pydantic refuses is mended, its misspelt keys respelt and a
harmless value put in each place at fault (a *hole*), until the models' own validators run too. What they then say
about a hole is only a consequence and is not reported.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import TypeAdapter, ValidationError

from .mistakes import (
    ABSENT,
    Fault,
    Mistake,
    closest,
    faults,
    keys_of,
    named,
    resolve,
    schema_at,
    tags_of,
    unknown_key,
    unknown_kind,
)

Place = tuple[str | int, ...]
SAME_WORD = 0.75  # likeness from which a misspelt key is read as the one that was meant

STAND_INS: dict[str, Any] = {  # objects that contradict nothing, where the required fields alone would
    "End": {"kind": "pinned", "position": [0.0, 0.0, 0.0]},
    "Start": {"kind": "given", "shape": [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]},
    "Motion": {"harmonics": [{"amplitude": [0.0, 0.0, 0.0], "frequency": 1.0}]},
    "Table": {"t": [0.0, 1.0, 2.0, 3.0], "x": [[0.0, 0.0, 0.0]] * 4},
    "Variable": {"values": [1.0]},
    "Sampler": {"n": 1},
    "Bound": {"max": 1.0},
    "Fatigue": {"E": 1.0, "m": 1.0, "log_a": 1.0},
}


@dataclass
class Reading:
    """A section of a study as far as it can be understood."""

    value: Any = ABSENT  # the mended section, validated; ABSENT where its parts contradict one another
    raw: Any = ABSENT  # what was written, misspelt keys respelt
    tree: Any = ABSENT  # the same, mended
    outline: Any = ABSENT  # the same, with every field that it may have; ABSENT where that is not known
    holes: set[Place] = field(default_factory=set)
    mistakes: list[Mistake] = field(default_factory=list)

    def sure(self, *place: str | int) -> bool:
        """Whether the value at a place is the one that the study gives."""
        return not any(hole[: len(place)] == place or place[: len(hole)] == hole for hole in self.holes)


def plain(raw: Any) -> Any:
    """A copy in which every mapping is a dict and every sequence a list; RecursionError where it holds itself."""
    if isinstance(raw, Mapping):
        return {key: plain(value) for key, value in raw.items()}
    return [plain(item) for item in raw] if isinstance(raw, list | tuple) else raw


def read(adapter: TypeAdapter[Any], raw: Any, name: str) -> Reading:
    """A section, and all that is wrong with it."""
    schema = adapter.json_schema()
    defs = schema.get("$defs", {})
    found = Reading()
    spelt: dict[Place, Place] = {}
    found.raw = _respell(plain(raw), schema, defs, (), found, spelt, name)
    found.tree = plain(found.raw)
    found.outline = _outline(found.raw, schema, defs)
    patched: set[Place] = set()
    while found.value is ABSENT:
        try:
            found.value = adapter.validate_python(found.tree)
        except ValidationError as error:
            errors = faults(error, found.tree, name, schema)
            fresh = [fault for fault in errors if not _known(fault, found.holes)]
            found.mistakes += [_as_spelt(fault.mistake, spelt, name) for fault in fresh]
            places = list(dict.fromkeys(_outermost(fault.at, patched) for fault in errors))
            if () in places and not _leave_out(errors, found, schema):
                if not all(fault.sentence for fault in errors):
                    found.holes.add(())
                break
            now: list[Place] = []
            for place in sorted(filter(None, places), key=len):
                if not any(place[: len(outer)] == outer for outer in now):
                    _put(found.tree, place, _stand_in(schema_at(schema, place, found.tree), defs))
                    now.append(place)
            patched.update(now)
            found.holes.update(now)
    found.tree = _outline(found.tree, schema, defs)
    return found


def _leave_out(errors: Iterable[Fault], found: Reading, schema: dict[str, Any]) -> bool:
    """Give the fields that contradict the rest of a section their defaults; whether there was one to give."""
    changed = False
    for fault in errors:
        place = fault.field[:1]
        field = schema.get("properties", {}).get(place[0] if place else None, {})
        if not fault.at and len(fault.field) == 1 and "default" in field and place not in found.holes:
            _put(found.tree, place, plain(field["default"]))
            found.holes.add(place)
            changed = True
    return changed


def _outermost(place: Place, patched: set[Place]) -> Place:
    """The place to mend: further out where mending it has not helped."""
    while place in patched:
        place = place[:-1]
    return place


def _known(fault: Fault, holes: Iterable[Place]) -> bool:
    """Whether an error is only the consequence of others."""
    if not fault.sentence:
        return any(fault.at[: len(hole)] == hole for hole in holes)
    return follows(fault.sentence, fault.at, holes)


def follows(sentence: str, model: Place, holes: Iterable[Place]) -> bool:
    """Whether what a model's validator says may come from a hole: one in its kind, or in a field that it names."""
    for hole in holes:
        inner = hole[len(model) :]
        if hole[: len(model)] != model:
            if hole == model[: len(hole)]:
                return True
            continue
        if not inner or inner[0] == "kind":
            return True
        word = re.escape(str(inner[0]))
        if inner[0] == "devices" and len(inner) > 1:
            word = rf"devices\[{inner[1]}\]"
        elif inner[0] == "cable" and len(inner) > 2 and inner[2] != "length":
            continue  # the devices' places depend on its length alone
        if re.search(rf"(?<![\w.]){word}(?![\w\[])", sentence):
            return True
    return False


def _put(tree: Any, place: Place, value: Any) -> None:
    for part in place[:-1]:
        tree = tree[part]
    if isinstance(tree, list) and place[-1] == len(tree):
        tree.append(value)
    else:
        tree[place[-1]] = value


# --------------------------------------------------------------------------- keys


def match_keys(raw: Mapping[Any, Any], keys: Iterable[str]) -> Iterator[tuple[Any, str | None, bool]]:
    """(as written, as meant, whether that is sure) of each key; None where no missing key is like it."""
    keys = list(keys)
    missing = {key for key in keys if key not in raw}
    for key in raw:
        if key in keys:
            yield key, key, True
            continue
        meant = closest(key, keys)
        if meant not in missing:
            yield key, None, False
            continue
        missing.discard(meant)
        yield key, meant, closest(key, keys, SAME_WORD) == meant


def _respell(
    raw: Any,
    node: dict[str, Any],
    defs: dict[str, Any],
    at: Place,
    found: Reading,
    spelt: dict[Place, Place],
    name: str,
) -> Any:
    """The same with the keys and kinds that were meant; a hole where that is not clear."""

    def inner(value: Any, node: dict[str, Any], part: str | int) -> Any:
        return _respell(value, node, defs, (*at, part), found, spelt, name)

    if isinstance(raw, dict):
        tags = tags_of(node)
        kind = raw.get("kind", ABSENT)
        if tags and kind not in tags:
            written = named(name, (*at, "kind"))
            found.mistakes.append(_as_spelt(unknown_kind(written, kind, tags), spelt, name))
            meant = closest(kind, tags, SAME_WORD)
            if meant is None:
                found.holes.add(at)
                return ABSENT
            found.holes.add((*at, "kind"))
            raw = raw | {"kind": meant}
        node = resolve(node, raw, defs)
        if "properties" not in node:
            values = node.get("additionalProperties")
            return {k: inner(v, values, k) for k, v in raw.items()} if isinstance(values, dict) else raw
        known: dict[str, Any] = {}
        for key, meant, sure in match_keys(raw, keys_of(node)):
            if key != meant:
                mistake = unknown_key(named(name, (*at, key)), raw[key], key, keys_of(node))
                found.mistakes.append(_as_spelt(mistake, spelt, name))
            if meant is None:
                continue
            if not sure:
                found.holes.add((*at, meant))
            elif key != meant:
                spelt[(*at, meant)] = (*at, key)
            known[meant] = inner(raw[key], node["properties"][meant], meant) if sure else ABSENT
        return known
    node = resolve(node, raw, defs)
    if isinstance(raw, list) and isinstance(node.get("items"), dict):
        return [inner(item, node["items"], i) for i, item in enumerate(raw)]
    return raw


def _as_spelt(mistake: Mistake, spelt: Mapping[Place, Place], name: str) -> Mistake:
    """The path as it stands in the study, wrong keys included."""
    for meant, written in spelt.items():
        path = named(name, meant)
        if re.match(rf"{re.escape(path)}(?!\w)", mistake.path):
            mistake = mistake._replace(path=named(name, written) + mistake.path[len(path) :])
    return mistake


# --------------------------------------------------------------------------- values


def _stand_in(node: dict[str, Any], defs: dict[str, Any]) -> Any:
    """A value that the schema allows."""
    node = resolve(node, ABSENT, defs)
    if node.get("title") in STAND_INS:
        return plain(STAND_INS[node["title"]])
    if "const" in node or "enum" in node:
        return node.get("const", node.get("enum", [None])[0])
    match node.get("type"):
        case "number" | "integer":
            low = max(node.get(key, 0) for key in ("ge", "gt", "minimum", "exclusiveMinimum"))
            high = min(node.get(key, 2 * low + 4) for key in ("le", "lt", "maximum", "exclusiveMaximum"))
            middle = (low + high) / 2
            return int(middle) if node["type"] == "integer" else middle
        case "string":
            return "?"
        case "boolean":
            return False
        case "array":
            count = node.get("minItems", 0)
            return [
                _stand_in(item, defs) for item in node.get("prefixItems", [node.get("items", {})] * count)
            ]
    wanted = {*node.get("required", ()), "kind"} & node.get("properties", {}).keys()
    return {key: _stand_in(node["properties"][key], defs) for key in wanted}


def _outline(raw: Any, node: dict[str, Any], defs: dict[str, Any]) -> Any:
    """What is written with every field that may be: where a path may lead, whatever stands there."""
    if raw is None and any(option.get("type") == "null" for option in node.get("anyOf", ())):
        return None
    node = resolve(node, raw, defs)
    if "properties" in node:
        if not isinstance(raw, dict):
            return ABSENT
        required = node.get("required", ())
        full = {}
        for key, inner in node["properties"].items():
            if key in raw or key in required:
                full[key] = _outline(raw.get(key, ABSENT), inner, defs)
            else:
                full[key] = inner["default"] if "default" in inner else _outline({}, inner, defs)
        return full
    if node.get("type") == "array":
        if not isinstance(raw, list) or ("prefixItems" not in node and len(raw) < node.get("minItems", 0)):
            return ABSENT
        if "prefixItems" in node:
            raw = raw + [ABSENT] * (len(node["prefixItems"]) - len(raw))
        items = node.get("prefixItems", [node.get("items", {})] * len(raw))
        return [_outline(item, inner, defs) for item, inner in zip(raw, items, strict=False)]
    return raw
