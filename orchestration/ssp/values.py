"""Parameter sets (SSV) and parameter mappings (SSM) of SSP packages: what a model element is given, name by name."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Element

from robomill.orchestration.ssp.files import Files, FmuVariable, child

SET = ("", "application/x-ssp-parameter-set")
MAPPING = ("", "application/x-ssp-parameter-mapping")
_INTEGERS = tuple(f"{sign}Int{bits}" for bits in (8, 16, 32, 64) for sign in ("", "U"))
_REALS = ("Real", "Float64", "Float32")


@dataclass(frozen=True)
class Given:
    """A value of a parameter set."""

    kind: str
    """Its type: Real, Integer, Boolean, String, Enumeration, Float64, ..."""
    value: Any
    """Or a list of them."""
    unit: str | None = None
    factor: float = 1.0
    offset: float = 0.0
    """Of a linear transformation, after the value was turned into the unit of its target."""


def bindings(files: Files, element: Element, what: str) -> Iterator[tuple[str, Given]]:
    """(name, value) of all parameter bindings of a component or system in their order, prefixed and mapped; later ones win."""
    for binding in element.iterfind("ParameterBindings/ParameterBinding"):
        if binding.get("type", "") not in SET:
            raise files.fail(f"{what}: parameters of type {binding.get('type')!r} cannot be read; only parameter sets ({SET[1]})")
        values = _content(files, binding, "ParameterValues", "ParameterSet", f"parameters of {what}", binding)
        prefix = binding.get("prefix", "")
        given = {
            prefix + p.get("name", ""): _given(files, p, f"{what}: parameter {p.get('name', '')!r}")
            for p in values.iterfind("Parameters/Parameter")
        }
        mapping = child(binding, "ParameterMapping")
        if mapping is None:
            yield from given.items()
            continue
        if mapping.get("type", "") not in MAPPING:
            raise files.fail(f"{what}: a parameter mapping of type {mapping.get('type')!r} cannot be read; only {MAPPING[1]}")
        table = _content(files, mapping, None, "ParameterMapping", f"parameter mapping of {what}", mapping)
        for entry in table.iterfind("MappingEntry"):
            source, target = entry.get("source", ""), entry.get("target", "")
            if source in given:
                yield target, _mapped(files, entry, given[source], f"{what}: mapping of parameter {source!r} to {target!r}")


def _content(files: Files, element: Element, inline: str | None, root: str, what: str, named: Element) -> Element:
    """What stands within (in the child `inline`, if there is one) or in the file that `source` names."""
    if named.get("sourceBase", "SSD") != "SSD":
        raise files.fail(f"{what} inside an FMU (sourceBase = {named.get('sourceBase')!r}) cannot be read; put them into the package")
    place = element if inline is None else child(element, inline)
    found = child(place, root) if place is not None else None
    if found is not None:
        return found
    if not named.get("source"):
        raise files.fail(f"{what}: neither a source nor a {root} within")
    return files.xml(files.place(named.get("source", ""), what), root)


def _given(files: Files, parameter: Element, what: str) -> Given:
    typed = next((e for e in parameter if e.tag not in ("Annotations", "Dimension")), None)
    kind = "nothing" if typed is None else typed.tag
    texts = [] if typed is None else [v.get("value", v.text or "") for v in typed.iterfind("Value")]
    text = None if typed is None else typed.get("value")
    if typed is None or kind not in _VALUES or (text is None and not texts):
        raise files.fail(f"{what} is of type {kind}; expected a value of type {', '.join(_VALUES)}")
    is_array = child(parameter, "Dimension") is not None
    if text is not None:
        texts = text.split() if is_array and kind != "String" else [text]
    try:
        values = [_VALUES[kind](t) for t in texts]
    except ValueError:
        raise files.fail(f"{what} = {text or texts!r} is not of type {kind}") from None
    return Given(kind, values if is_array else values[0], typed.get("unit"))


def _mapped(files: Files, entry: Element, given: Given, what: str) -> Given:
    """The value after the transformation of a mapping entry."""
    if entry.get("suppressUnitConversion") in ("true", "1"):
        given = replace(given, unit=None)
    transformation = next((e for e in entry if e.tag.endswith("Transformation")), None)
    if transformation is None:
        return given
    try:
        if transformation.tag == "LinearTransformation" and given.kind in _REALS:
            return replace(given, factor=float(transformation.get("factor", "1")), offset=float(transformation.get("offset", "0")))
        kinds = {"BooleanMappingTransformation": ("Boolean",), "IntegerMappingTransformation": ("Integer", "Enumeration", *_INTEGERS)}
        kinds["EnumerationMappingTransformation"] = ("Enumeration",)
        if given.kind in kinds.get(transformation.tag, ()):
            read = _VALUES[given.kind]
            table = {read(e.get("source", "")): read(e.get("target", "")) for e in transformation.iterfind("MapEntry")}
            old = given.value
            return replace(given, value=[table.get(v, v) for v in old] if isinstance(old, list) else table.get(old, old))
    except ValueError as error:
        raise files.fail(f"{what}: {transformation.tag}: {error}") from None
    raise files.fail(f"{what}: a {transformation.tag} does not go with a value of type {given.kind}")


def resolved(files: Files, given: Given, variable: FmuVariable | None, what: str) -> Any:
    """The value as `Component.parameters` has it: a number, a text, a list, or these with a unit; `variable` is what it is for."""
    value, unit = given.value, given.unit
    if given.kind == "Enumeration":
        value = [_item(files, v, variable, what) for v in value] if isinstance(value, list) else _item(files, value, variable, what)
    if (given.factor, given.offset) != (1.0, 0.0):
        wanted = variable.unit if variable is not None else None
        if unit is not None and unit != wanted:
            raise files.fail(f"{what}: its mapping transforms a value in {unit!r} that is wanted in {wanted!r}: give it in that unit")
        unit = None
        value = [given.factor * v + given.offset for v in value] if isinstance(value, list) else given.factor * value + given.offset
    return {"value": value, "unit": unit} if unit else value


def _item(files: Files, text: str, variable: FmuVariable | None, what: str) -> int:
    """Value of an enumeration's item: by the names that the FMU gives them, or a number."""
    items = variable.items if variable is not None else {}
    if text in items:
        return items[text]
    try:
        return int(text)
    except ValueError:
        raise files.fail(f"{what} = {text!r} is not an item of its enumeration; items: {', '.join(items) or 'none are known'}") from None


def truth(text: str) -> bool:
    """A boolean of XML Schema."""
    if text.strip() not in ("true", "false", "1", "0"):
        raise ValueError(text)
    return text.strip() in ("true", "1")


_VALUES: dict[str, Any] = {
    **dict.fromkeys(_REALS, float),
    "Integer": int,
    **dict.fromkeys(_INTEGERS, int),
    "Boolean": truth,
    "String": str,
    "Enumeration": str,
}
