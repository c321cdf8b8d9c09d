"""C source of a lowered model: the LLVM code of `lower.py`, instruction by instruction, as portable C99.

For importers that compile (source-code FMUs). Every LLVM value is a local variable, every block a label; integers are unsigned, so
that they wrap; memory is read and written through `memcpy`. Vectors are taken apart into their elements. The arithmetic of doubles is
that of the LLVM code, one operation a line, so a compiler that contracts nothing gives the bits of the libraries built here.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from robomill.fmus.native.lower import NativeBuildError

PRELUDE = r"""/* Generated from the LLVM code of the model: IEEE 754 double arithmetic, nothing contracted or reordered. */
#include "component.h"
#include <float.h>
#include <math.h>
#include <string.h>
#if defined(__FAST_MATH__) || FLT_EVAL_METHOD != 0
#error "needs IEEE 754 arithmetic in double precision: no -ffast-math, no x87"
#endif
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif

#define MEMORY(T, NAME) \
    static inline T load_##NAME(const char *p) { T x; memcpy(&x, p, sizeof x); return x; } \
    static inline void store_##NAME(char *p, T x) { memcpy(p, &x, sizeof x); }
MEMORY(double, double) MEMORY(uint64_t, i64) MEMORY(uint32_t, i32) MEMORY(uint16_t, i16) MEMORY(uint8_t, i8) MEMORY(char *, ptr)

/* Whether x is of one of the classes in the mask of LLVM's is.fpclass. */
static inline int of_class(double x, int mask) {
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    uint64_t exponent = bits >> 52 & 0x7ff, fraction = bits & 0xfffffffffffff;
    int negative = (int)(bits >> 63);
    if (exponent == 0x7ff && fraction)
        return mask >> (int)(fraction >> 51 & 1) & 1;
    int kind = exponent == 0x7ff ? 0 : exponent ? 1 : fraction ? 2 : 3;
    return mask >> (negative ? 2 + kind : 9 - kind) & 1;
}
"""
TYPES = {"double": "double", "ptr": "char *", "i1": "uint8_t", "i8": "uint8_t", "i16": "uint16_t", "i32": "uint32_t", "i64": "uint64_t"}
SIGNED = {"i8": "int8_t", "i16": "int16_t", "i32": "int32_t", "i64": "int64_t"}
SIZES = {"double": 8, "ptr": 8, "i8": 1, "i16": 2, "i32": 4, "i64": 8}
_INFIX = {
    "fadd": "+",
    "fsub": "-",
    "fmul": "*",
    "fdiv": "/",
    "add": "+",
    "sub": "-",
    "mul": "*",
    "and": "&",
    "or": "|",
    "xor": "^",
    "shl": "<<",
}
_INFIX |= {"lshr": ">>", "udiv": "/", "urem": "%"}
_SIGNED_INFIX = {"ashr": ">>", "sdiv": "/", "srem": "%"}
_COMPARED = {"eq": "==", "ne": "!=", "ugt": ">", "uge": ">=", "ult": "<", "ule": "<=", "sgt": ">", "sge": ">=", "slt": "<", "sle": "<="}
_FLOATS = {
    "oeq": "{a} == {b}",
    "ogt": "{a} > {b}",
    "oge": "{a} >= {b}",
    "olt": "{a} < {b}",
    "ole": "{a} <= {b}",
    "one": "({a} < {b} || {a} > {b})",
    "ord": "({a} == {a} && {b} == {b})",
    "ueq": "!({a} < {b} || {a} > {b})",
    "ugt": "!({a} <= {b})",
    "uge": "!({a} < {b})",
    "ult": "!({a} >= {b})",
    "ule": "!({a} > {b})",
    "une": "{a} != {b}",
    "uno": "({a} != {a} || {b} != {b})",
}
_CALLS = {"sqrt": "sqrt({0})", "fabs": "fabs({0})", "floor": "floor({0})", "ceil": "ceil({0})", "trunc": "trunc({0})"}
_CALLS |= {"copysign": "copysign({0}, {1})", "is.fpclass": "of_class({0}, {1})"}
_CALLS |= {"smax": "(int64_t){0} > (int64_t){1} ? {0} : {1}", "smin": "(int64_t){0} < (int64_t){1} ? {0} : {1}"}
_CALLS |= {"umax": "{0} > {1} ? {0} : {1}", "umin": "{0} < {1} ? {0} : {1}", "usub.sat": "{0} > {1} ? {0} - {1} : 0"}
_CALLS |= {"abs": "(int64_t){0} < 0 ? -{0} : {0}"}
_FLAGS = re.compile(r"\b(?:nuw|nsw|exact|nneg|disjoint|samesign|inbounds|nusw|tail|musttail|notail|fastcc|volatile)\b ?")
_SUFFIX = re.compile(r"(?:, ![\w.]+ !\d+)*(?: #\d+)?(?:, ![\w.]+ !\d+)*$")
_ANY_VALUE = re.compile(r"poison|undef")
"""Elements of a mask that nothing reads."""
_VECTOR = re.compile(r"<(\d+) x (\w+)>")
_ARRAY = re.compile(r"\[(\d+) x (.+)\]")


def model_c(code: str) -> bytes:
    """The C file that defines `model_init` and `model_step`. NativeBuildError names an instruction that it does not know."""
    functions = [_Function(head, body) for head, body in _definitions(code)]
    bodies = [f.text() for f in functions]
    used = sorted({name for text in bodies for name in re.findall(r"\bglobal_\d+\b", text)}, key=lambda name: int(name.partition("_")[2]))
    data = [_global(name, code) for name in used]
    return "\n".join([PRELUDE, *data, *(f.head() + ";" for f in functions), "", *bodies, _ENTRIES]).encode()


def _global(name: str, code: str) -> str:
    """Definition of a constant: an array of numbers, or an exception, of which only the address counts (it says that there is one)."""
    found = re.search(rf"(?m)^@{name} = internal (?:unnamed_addr )?constant (.*)", code)
    text = found[1] if found else ""
    if text.startswith("{ ptr, i32, ptr, ptr, i32 }"):
        return f"static const char {name}[1];"
    array = re.match(r"\[(\d+) x (double|i64)\] \[(.*?)\]", text)
    if array is None:
        raise NativeBuildError(f"no C code for the constant {name} = {text[:60]}")
    numbers = (v.split()[1] for v in array[3].split(", "))
    values = ", ".join(_double(v) if array[2] == "double" else f"UINT64_C({int(v) % 2**64})" for v in numbers)
    return f"static const {TYPES[array[2]]} {name}[{array[1]}] = {{{values}}};"


_ENTRIES = """int32_t model_init(int64_t *status, void **exception, Word *record) {
    return (int32_t)llvm_model_init((char *)status, (char *)exception, (char *)record);
}
int32_t model_step(int64_t *status, void **exception, Word *record, double t, double h) {
    return (int32_t)llvm_model_step((char *)status, (char *)exception, (char *)record, t, h);
}
"""


def _definitions(code: str) -> Iterator[tuple[str, list[str]]]:
    """Head and lines of every function."""
    for found in re.finditer(r"(?ms)^define (.*?) \{\n(.*?)^\}", code):
        lines = [re.sub(r" *; preds = .*", "", line).rstrip() for line in found[2].splitlines()]
        yield found[1], [line for line in lines if line]


def _split(text: str, at: str = ",") -> list[str]:
    """The parts between separators that stand in no bracket."""
    parts, depth, start = [], 0, 0
    for i, ch in enumerate(text):
        depth += (ch in "([{<") - (ch in ")]}>")
        if ch == at and depth == 0:
            parts.append(text[start:i].strip())
            start = i + 1
    return [p for p in [*parts, text[start:].strip()] if p]


def _typed(text: str) -> tuple[str, str]:
    """Type and value of an operand or argument; attributes between them go."""
    constant = re.search(r"\b(?:getelementptr|inttoptr|splat) .*\)$", text)
    if constant:
        return _split(text[: constant.start()], " ")[0], constant.group()
    words = _split(text, " ")
    return words[0], words[-1]


def _size(of: str) -> int:
    """Bytes of a type."""
    array, vector = _ARRAY.fullmatch(of), _VECTOR.fullmatch(of)
    if array:
        return int(array[1]) * _size(array[2])
    if vector:
        return int(vector[1]) * _size(vector[2])
    if of not in SIZES:
        raise NativeBuildError(f"no C code for the type {of}")
    return SIZES[of]


@dataclass
class _Function:
    """One function: read line by line, written at the end, as its variables are declared first."""

    definition: str
    lines: list[str]
    variables: dict[str, str] = field(default_factory=dict)
    """Name -> C type."""
    phis: dict[str, list[tuple[str, str, dict[str, str]]]] = field(default_factory=dict)
    """Block -> (value, type, operand by block it is come from)."""
    declared: list[str] = field(default_factory=list)
    out: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        found = re.search(r"(\w+) @(\w+)\((.*)\)[^()]*$", re.sub(r" (?:local_)?unnamed_addr.*", "", self.definition))
        if found is None:
            raise NativeBuildError(f"no C code for the function {self.definition}")
        self.result, self.name = found[1], found[2] if found[2].startswith("function_") else f"llvm_{found[2]}"
        self.arguments = [_typed(a) for a in _split(found[3])]

    def head(self) -> str:
        """Its declaration, without the semicolon."""
        arguments = ", ".join(f"{TYPES[t]} v{v[1:]}" for t, v in self.arguments)
        return f"static {TYPES.get(self.result, 'void')} {self.name}({arguments or 'void'})"

    def text(self) -> str:
        """Its definition."""
        block = str(len(self.arguments))
        for line in self.lines:  # all phis are needed before the first branch
            label = re.match(r"(\d+):", line)
            block = label[1] if label else block
            phi = re.match(r"  %(\d+) = phi (<.*?>|\w+) (.*)", line)
            if phi:
                pairs = (_split(p[1:-1]) for p in _split(_SUFFIX.sub("", phi[3])))
                self.phis.setdefault(block, []).append((phi[1], phi[2], {b[1:]: value for value, b in pairs}))
        self.block = str(len(self.arguments))
        for line in _joined(self.lines):
            label = re.match(r"(\d+):", line)
            if label:
                self.block = label[1]
                self.out.append(f"L{self.block}:;")
                for value, of, _ in self.phis.get(self.block, []):
                    for part in self._parts(of):
                        self._set(f"{value}{part}", self._element(of), f"p{value}{part}")
                        self.variables[f"p{value}{part}"] = TYPES[self._element(of)]
            else:
                self._instruction(_SUFFIX.sub("", line.strip()))
        kinds: dict[str, list[str]] = {}
        for name, of in self.variables.items():
            kinds.setdefault(of, []).append(name)
        declarations = [f"    {of.rstrip(' *')} {', '.join(('*' if '*' in of else '') + n for n in names)};" for of, names in kinds.items()]
        return "\n".join([f"{self.head()} {{", *declarations, *self.declared, *self.out, "}", ""])

    def _parts(self, of: str) -> list[str]:
        """Endings of the names of its elements: one empty, but for vectors."""
        vector = _VECTOR.fullmatch(of)
        return [f"_{i}" for i in range(int(vector[1]))] if vector else [""]

    def _element(self, of: str) -> str:
        vector = _VECTOR.fullmatch(of)
        return vector[2] if vector else of

    def _set(self, name: str, of: str, expression: str) -> None:
        self.variables[f"v{name}"] = TYPES[of]
        self.out.append(f"    v{name} = {expression};")

    def _value(self, of: str, text: str, part: str = "") -> str:
        """C expression of an operand, or of one element of it."""
        if text.startswith("%"):
            return f"v{text[1:]}{part}"
        if text.startswith("splat"):
            return self._value(*_typed(text[7:-1]))
        if text.startswith("<"):
            return self._value(*_typed(_split(text[1:-1])[int(part[1:])]))
        of = self._element(of)
        if text in ("zeroinitializer", "poison", "undef", "null"):
            text = {"double": "0.0", "ptr": "null"}.get(of, "0")
        match of:
            case "ptr":
                return self._address(text)
            case "double":
                return _double(text)
            case "i1":
                return {"true": "1", "false": "0"}.get(text, text)
        return f"UINT64_C({int(text) % 2**64})" if of == "i64" else f"({TYPES[of]}){int(text) % 2 ** int(of[1:])}u"

    def _address(self, text: str) -> str:
        if text == "null":
            return "NULL"
        if text.startswith("@"):
            return f"(char *){text[1:]}"
        moved = re.fullmatch(r"getelementptr \(i8, ptr @(\w+), i64 (-?\d+)\)", text)
        if moved:
            return f"((char *){moved[1]} + {moved[2]})"
        raise NativeBuildError(f"no C code for the constant {text}")

    def _operation(self, name: str, of: str, expression: Callable[[str], str], element: str = "") -> None:
        """Assign an expression of each element; `element` is the type of the result where it is another."""
        for part in self._parts(of):
            self._set(name + part, element or self._element(of), expression(part))

    def _instruction(self, line: str) -> None:
        found = re.match(r"(?:%(\d+) = )?(.*)", _FLAGS.sub("", line))
        assert found is not None
        name, rest = found[1] or "", found[2]
        opcode, _, operands = rest.partition(" ")
        method = getattr(self, f"_do_{opcode}", None)
        if opcode == "phi":  # set where the block begins
            return
        if opcode in _INFIX or opcode in _SIGNED_INFIX:
            self._binary(name, opcode, operands)
        elif method is None or operands.startswith("atomic "):
            raise NativeBuildError(f"no C code for the instruction {line!r}")
        else:
            method(name, operands)

    def _binary(self, name: str, opcode: str, operands: str) -> None:
        first, second = _split(operands)
        of, a = _typed(first)
        element = self._element(of)

        def expression(part: str) -> str:
            x, y = self._value(of, a, part), self._value(of, second, part)
            if opcode in _SIGNED_INFIX:
                signed = SIGNED[element]
                return f"({TYPES[element]})(({signed}){x} {_SIGNED_INFIX[opcode]} ({signed}){y})"
            text = f"{x} {_INFIX[opcode]} {y}"
            if element == "i1":
                return f"({text}) & 1"
            return text if element in ("double", "i64") else f"({TYPES[element]})({text})"

        self._operation(name, of, expression)

    def _do_fneg(self, name: str, operands: str) -> None:
        of, a = _typed(operands)
        self._operation(name, of, lambda part: f"-{self._value(of, a, part)}")

    def _do_freeze(self, name: str, operands: str) -> None:
        of, a = _typed(operands)
        self._operation(name, of, lambda part: self._value(of, a, part))

    def _do_fcmp(self, name: str, operands: str) -> None:
        kind, _, operands = operands.partition(" ")
        first, second = _split(operands)
        of, a = _typed(first)
        self._operation(name, of, lambda part: _FLOATS[kind].format(a=self._value(of, a, part), b=self._value(of, second, part)), "i1")

    def _do_icmp(self, name: str, operands: str) -> None:
        kind, _, operands = operands.partition(" ")
        first, second = _split(operands)
        of, a = _typed(first)
        cast = f"({SIGNED[self._element(of)]})" if kind[0] == "s" else "(uintptr_t)" if of == "ptr" else ""
        self._operation(
            name, of, lambda part: f"{cast}{self._value(of, a, part)} {_COMPARED[kind]} {cast}{self._value(of, second, part)}", "i1"
        )

    def _do_select(self, name: str, operands: str) -> None:
        (kind, condition), (of, a), (_, b) = (_typed(p) for p in _split(operands))
        one = self._parts(kind) == [""]
        self._operation(
            name,
            of,
            lambda part: f"{self._value(kind, condition, '' if one else part)} ? {self._value(of, a, part)} : {self._value(of, b, part)}",
        )

    def _cast(self, name: str, operands: str, expression: Callable[[str, str, str], str]) -> None:
        source, _, target = operands.rpartition(" to ")
        of, a = _typed(source)
        element = self._element(target)
        self._operation(name, of, lambda part: expression(self._element(of), element, self._value(of, a, part)), element)

    def _do_zext(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, to, x: f"({TYPES[to]}){x}")

    def _do_sext(self, name: str, operands: str) -> None:
        self._cast(
            name, operands, lambda of, to, x: f"({TYPES[to]})-({SIGNED[to]}){x}" if of == "i1" else f"({TYPES[to]})({SIGNED[of]}){x}"
        )

    def _do_trunc(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, to, x: f"{x} & 1" if to == "i1" else f"({TYPES[to]}){x}")

    def _do_sitofp(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda of, _, x: f"-(double){x}" if of == "i1" else f"(double)({SIGNED[of]}){x}")

    def _do_uitofp(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, __, x: f"(double){x}")

    def _do_fptosi(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, to, x: f"({TYPES[to]})({SIGNED[to]}){x}")

    def _do_inttoptr(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, __, x: f"(char *)(uintptr_t){x}")

    def _do_ptrtoint(self, name: str, operands: str) -> None:
        self._cast(name, operands, lambda _, to, x: f"({TYPES[to]})(uintptr_t){x}")

    def _do_bitcast(self, name: str, operands: str) -> None:
        source, _, target = operands.rpartition(" to ")
        of, a = _typed(source)
        if of != target:
            raise NativeBuildError(f"no C code for bitcast {operands}")
        self._set(name, of, self._value(of, a))

    def _do_getelementptr(self, name: str, operands: str) -> None:
        of, base, *indices = _split(operands)
        terms = [self._value(*_typed(base))]
        for index in indices:
            kind, text = _typed(index)
            size = _size(of)
            terms.append(
                str(int(text) * size) if not text.startswith("%") else f"(int64_t)({size}u * (uint64_t)({SIGNED[kind]})v{text[1:]})"
            )
            array = _ARRAY.fullmatch(of)
            of = array[2] if array else of
        self._set(name, "ptr", " + ".join(terms))

    def _do_alloca(self, name: str, operands: str) -> None:
        of = _split(operands)[0]
        self.declared.append(f"    double a{name}[{-(-_size(of) // 8)}];")
        self._set(name, "ptr", f"(char *)a{name}")

    def _do_load(self, name: str, operands: str) -> None:
        of, address = _split(operands)[:2]
        element = self._element(of)
        for i, part in enumerate(self._parts(of)):
            self._set(name + part, element, f"load_{element}({self._value(*_typed(address))} + {i * _size(element)})")

    def _do_store(self, _: str, operands: str) -> None:
        value, address = _split(operands)[:2]
        of, a = _typed(value)
        element = self._element(of)
        for i, part in enumerate(self._parts(of)):
            self.out.append(f"    store_{element}({self._value(*_typed(address))} + {i * _size(element)}, {self._value(of, a, part)});")

    def _do_insertelement(self, name: str, operands: str) -> None:
        (of, vector), (kind, value), (_, index) = (_typed(p) for p in _split(operands))
        self._operation(name, of, lambda part: self._value(kind, value) if part == f"_{index}" else self._value(of, vector, part))

    def _do_extractelement(self, name: str, operands: str) -> None:
        (of, vector), (_, index) = (_typed(p) for p in _split(operands))
        self._set(name, self._element(of), self._value(of, vector, f"_{index}"))

    def _do_shufflevector(self, name: str, operands: str) -> None:
        first, second, mask = _split(operands)
        (of, a), (_, b) = _typed(first), _typed(second)
        shape = _VECTOR.match(mask)
        assert shape is not None
        count, wide, chosen = int(shape[1]), len(self._parts(of)), mask[shape.end() :].strip()
        indices = [0] * count if chosen == "zeroinitializer" else [int(_ANY_VALUE.sub("0", p).split()[-1]) for p in _split(chosen[1:-1])]
        for i, k in enumerate(indices):
            self._set(f"{name}_{i}", self._element(of), self._value(of, a, f"_{k}") if k < wide else self._value(of, b, f"_{k - wide}"))

    def _do_extractvalue(self, name: str, operands: str) -> None:
        pair, index = _split(operands)
        self._set(name, "i1" if index == "1" else "i64", f"v{pair.rpartition('%')[2]}_{index}")

    def _do_call(self, name: str, operands: str) -> None:
        found = re.match(r"(.*?) ?@([\w.]+)\((.*)\)$", operands)
        if found is None:
            raise NativeBuildError(f"no C code for call {operands}")
        kind, called = _split(found[1], " ")[-1], found[2]
        arguments = [_typed(a) for a in _split(found[3])]
        values = [self._value(of, text) for of, text in arguments]
        if not called.startswith("llvm."):
            call = f"{called}({', '.join(values)})"
            if name:
                self._set(name, kind, call)
            else:
                self.out.append(f"    {call};")
            return
        intrinsic = re.sub(r"\.(?:p0|i\d+|f64)\b", "", called.removeprefix("llvm."))
        bits = {of for of, _ in arguments if of.startswith("i")}
        if intrinsic.startswith(("lifetime.", "assume", "experimental.noalias")):
            return
        if intrinsic in ("memset", "memcpy", "memmove"):
            size = f"(size_t){values[2]}"
            self.out.append(f"    {intrinsic}({values[0]}, {values[1]}, {size});")
        elif intrinsic.startswith("vector.reduce.add.") and kind == "i64":
            (of, text) = arguments[0]
            self._set(name, kind, " + ".join(self._value(of, text, part) for part in self._parts(of)))
        elif intrinsic in ("uadd.with.overflow", "usub.with.overflow") and arguments[0][0] == "i64":
            a, b = values
            added = intrinsic.startswith("uadd")
            self._set(f"{name}_0", "i64", f"{a} {'+' if added else '-'} {b}")
            self._set(f"{name}_1", "i1", f"v{name}_0 < {a}" if added else f"{a} < {b}")
        elif intrinsic in _CALLS and not (intrinsic in ("smax", "smin", "abs") and bits - {"i64", "i1"}) and kind in TYPES:
            self._set(name, kind, _CALLS[intrinsic].format(*values))
        else:
            raise NativeBuildError(f"no C code for call {operands}")

    def _go(self, label: str) -> str:
        """A jump to a block, after what it takes from this one."""
        target = label.rpartition("%")[2]
        taken = [
            f"p{value}{part} = {self._value(of, sources[self.block], part)};"
            for value, of, sources in self.phis.get(target, [])
            for part in self._parts(of)
        ]
        return " ".join([*taken, f"goto L{target};"])

    def _do_br(self, _: str, operands: str) -> None:
        parts = _split(operands)
        if len(parts) == 1:
            self.out.append(f"    {self._go(parts[0])}")
        else:
            condition = self._value(*_typed(parts[0]))
            self.out.append(f"    if ({condition}) {{ {self._go(parts[1])} }} else {{ {self._go(parts[2])} }}")

    def _do_switch(self, _: str, operands: str) -> None:
        value, default, cases = re.fullmatch(r"(.*?), (label %\d+) \[(.*)\]", operands).groups()  # type: ignore[union-attr]
        of, a = _typed(value)
        self.out.append(f"    switch ({self._value(of, a)}) {{")
        for constant, target in re.findall(r"i\d+ (-?\d+), label (%\d+)", cases):
            self.out.append(f"        case {self._value(of, constant)}: {self._go(target)}")
        self.out.append(f"        default: {self._go(default)}\n    }}")

    def _do_ret(self, _: str, operands: str) -> None:
        self.out.append("    return;" if operands == "void" else f"    return {self._value(*_typed(operands))};")

    def _do_unreachable(self, _: str, __: str) -> None:
        self.out.append("    return 0;" if self.result != "void" else "    return;")


def _joined(lines: list[str]) -> Iterator[str]:
    """The lines with every switch in one."""
    switch = ""
    for line in lines:
        if switch or line.endswith("["):
            switch += " " + line.strip()
            if line.strip().startswith("]"):
                yield switch
                switch = ""
        else:
            yield line


def _double(text: str) -> str:
    """A C constant with the same bits: hexadecimal, or an expression for infinity and NaN."""
    value: float = struct.unpack(">d", int(text, 16).to_bytes(8, "big"))[0] if text.startswith("0x") else float(text)
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return value.hex()
