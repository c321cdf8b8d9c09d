"""Parameter bindings of SSP packages: what an element is given, name by name, by parameter sets (SSV) and mappings (SSM)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from xml.etree.ElementTree import Element

from robomill.orchestration.ssp.files import Files, FmuVariable, child
from robomill.orchestration.ssp.parameter_set import INTEGERS, REALS, VALUES, Given, given_by

SET = ("", "application/x-ssp-parameter-set")
MAPPING = ("", "application/x-ssp-parameter-mapping")


def bindings(files: Files, element: Element, what: str) -> Iterator[tuple[str, Given]]:
    """(name, value) of all parameter bindings of a component or system in their order, prefixed and mapped; later ones win."""
    for binding in element.iterfind("ParameterBindings/ParameterBinding"):
        if binding.get("type", "") not in SET:
            raise files.fail(
                f"{what}: parameters of type {binding.get('type')!r} cannot be read; only parameter sets ({SET[1]})"
                "; convert them to such a set"
            )
        values = _content(files, binding, "ParameterValues", "ParameterSet", f"parameters of {what}", binding)
        prefix = binding.get("prefix", "")
        given = {
            prefix + p.get("name", ""): given_by(files, p, f"{what}: parameter {p.get('name', '')!r}")
            for p in values.iterfind("Parameters/Parameter")
        }
        mapping = child(binding, "ParameterMapping")
        if mapping is None:
            yield from given.items()
            continue
        if mapping.get("type", "") not in MAPPING:
            raise files.fail(
                f"{what}: a parameter mapping of type {mapping.get('type')!r} cannot be read; only {MAPPING[1]}; convert it to that"
            )
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
        raise files.fail(f"{what}: neither a source nor a {root} within; give one of them")
    return files.xml(files.place(named.get("source", ""), what), root)


def _mapped(files: Files, entry: Element, given: Given, what: str) -> Given:
    """The value after the transformation of a mapping entry."""
    if entry.get("suppressUnitConversion") in ("true", "1"):
        given = replace(given, unit=None)
    transformation = next((e for e in entry if e.tag.endswith("Transformation")), None)
    if transformation is None:
        return given
    try:
        if transformation.tag == "LinearTransformation" and given.kind in REALS:
            return replace(given, factor=float(transformation.get("factor", "1")), offset=float(transformation.get("offset", "0")))
        kinds = {"BooleanMappingTransformation": ("Boolean",), "IntegerMappingTransformation": ("Integer", "Enumeration", *INTEGERS)}
        kinds["EnumerationMappingTransformation"] = ("Enumeration",)
        if given.kind in kinds.get(transformation.tag, ()):
            read = VALUES[given.kind]
            table = {read(e.get("source", "")): read(e.get("target", "")) for e in transformation.iterfind("MapEntry")}
            old = given.value
            return replace(given, value=[table.get(v, v) for v in old] if isinstance(old, list) else table.get(old, old))
    except ValueError as error:
        raise files.fail(f"{what}: {transformation.tag}: {error}") from None
    raise files.fail(f"{what}: a {transformation.tag} does not go with a value of type {given.kind}; leave one of them out")


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
        raise files.fail(
            f"{what} = {text!r} is not an item of its enumeration; items: {', '.join(items) or 'none are known'}; choose one of these"
        ) from None
