"""Compiled functions as object code that is kept on disk and loaded without Numba, which takes half a second to import and wake.

Numba compiles; what is kept of that are the functions by name, in its calling convention, and what they call. LLVM's loader puts them
into memory. Only code that needs nothing of the process at run time can be kept; other code stays in the process that made it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import pickle
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from robomill.installed import version

FORBIDDEN = ("Py", "_Py", "NRT_", "numba_")
"""Beginnings of names of functions that only exist inside Python."""
_OF_C = r"|llvm\.(?:sin|cos)\.f64$" if sys.platform != "win32" else ""
ANYWHERE = (
    r"(?:memset|memcpy|memmove|sqrt)$"
    r"|llvm\.(?!(?:a?(?:sin|cos|tan)h?|atan2|sincos(?:pi)?|modf|exp\d*|log\d*|powi?|ldexp|frexp|fma)\.)" + _OF_C
)
"""Functions that kept code may call: instructions, and what each process has. LLVM ends a process over one that it does not find.

Elementary functions are those of the C library that Numba chose, which may round otherwise than the one found without it. Of sin and
cos there is one in a process, but on Windows; the square root is rounded correctly by all."""
_DIGEST = hashlib.sha256().digest_size
"""Bytes at the beginning of a kept file: the hash of the others."""
_RETURNED: Mapping[str, Any] = {"": ctypes.c_int64, ".float64": ctypes.c_double, ".bool": ctypes.c_bool}
"""What is added to the name of a function for the type that it returns. Nothing returned is read as 0."""
_Code = tuple[str, str, str]
"""Name that a function gets, name that it has, LLVM assembly of the module that defines it."""


class MachineCode:
    """Functions in memory, for as long as this object lives."""

    def __init__(self, content: bytes) -> None:
        """Load object code made for this processor. The process ends if it is torn: see `machine_code`."""
        llvm = _llvm()
        self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _loader())
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(content))
        self._engine.finalize_object()

    def address(self, name: str) -> int:
        """Address of a function, 0 if there is none of that name."""
        found: int = self._engine.get_function_address(name)
        return found

    def function(self, name: str, *kinds: Any) -> Callable[..., Any]:
        """A function with arguments of these `ctypes` types. It returns what it is compiled for, and raises what the compiled code raises.

        The interpreter lock is released while it runs.
        """
        kind, address = next((k, a) for n, k in _RETURNED.items() if (a := self.address(name + n)))
        call = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(kind), ctypes.POINTER(ctypes.c_void_p), *kinds)(address)
        by_reference = ctypes.byref

        def function(*arguments: Any) -> Any:
            returned, raised = kind(), ctypes.c_void_p()
            if call(by_reference(returned), by_reference(raised), *arguments):
                raise self._exception(raised.value)
            return returned.value

        return function

    def _exception(self, address: int | None) -> BaseException:
        """What the code raised, from where Numba put it: the pickled class and arguments, and their length."""
        if address:
            data = ctypes.c_void_p.from_address(address).value
            size = ctypes.c_int32.from_address(address + ctypes.sizeof(ctypes.c_void_p)).value
            with suppress(Exception):
                kind, arguments, *_ = pickle.loads(ctypes.string_at(data or 0, size))
                found: BaseException = kind(*(arguments or ()))
                return found
        return RuntimeError("an exception in compiled code")


def machine_code(file: Path | None, make: Callable[[], tuple[bytes, bool]]) -> MachineCode:
    """The code kept in `file`, else what `make` returns: object code, and whether it can be kept. None: it is not kept.

    The name of the file is completed by the processor and the versions of the compilers. Where nothing can be written, each process
    compiles. ImportError without Numba.
    """
    kept = None if file is None else file.with_name(f"{file.name}.{_target()}.o")
    if kept is not None:
        with suppress(OSError):
            found = kept.read_bytes()
            if hashlib.sha256(found[_DIGEST:]).digest() == found[:_DIGEST]:  # LLVM ends the process over a file that is torn
                return MachineCode(found[_DIGEST:])
    content, lasting = make()
    if kept is not None and lasting:
        with suppress(OSError):
            kept.parent.mkdir(parents=True, exist_ok=True)
            partial = kept.with_name(f"{kept.name}.{os.urandom(8).hex()}")  # others may write it, too, also in this process
            try:
                partial.write_bytes(hashlib.sha256(content).digest() + content)
                partial.replace(kept)
            finally:
                partial.unlink(missing_ok=True)
    return MachineCode(content)


def kind_of(argument: Any) -> str:
    """Numba's name of the type of an argument: a float, an integer, or an array."""
    if isinstance(argument, np.ndarray):
        return f"array({argument.dtype}, {argument.ndim}d, {'C' if argument.flags.c_contiguous else 'A'})"
    return "float64" if isinstance(argument, float) else "int64"


def numba_types(kinds: Sequence[str]) -> list[Any]:
    """What Numba compiles for arguments of these kinds."""
    from numba import types
    from numba.np.numpy_support import from_dtype

    array: Any = types.Array
    found: list[Any] = []
    for kind in kinds:
        dtype, *rest = kind[6:-1].split(", ") if kind.startswith("array") else (kind,)
        found.append(array(from_dtype(np.dtype(dtype)), int(rest[0][:-1]), rest[1]) if rest else getattr(types, kind))
    return found


def c_types(kinds: Sequence[str]) -> list[Any]:
    """How `flat` arguments of these kinds are handed over."""
    found: list[Any] = []
    for kind in kinds:
        if kind.startswith("array"):
            shape_and_strides = 2 * int(kind.split(", ")[1][:-1])
            found += [
                ctypes.c_void_p,
                ctypes.c_void_p,
                ctypes.c_int64,
                ctypes.c_int64,
                ctypes.c_void_p,
                *(shape_and_strides * [ctypes.c_int64]),
            ]
        else:
            found.append(ctypes.c_double if kind == "float64" else ctypes.c_int64)
    return found


def flat(arguments: Sequence[Any]) -> list[Any]:
    """Arguments as compiled code takes them: of an array its owners (none), number and bytes of elements, address, shape and strides."""
    found: list[Any] = []
    for a in arguments:
        if isinstance(a, np.ndarray):
            found += [None, None, a.size, a.itemsize, a.ctypes.data, *a.shape, *a.strides]
        else:
            found.append(a)
    return found


def object_code(
    functions: Mapping[str, tuple[Callable[..., Any], Sequence[Any]]], options: Mapping[str, Any], c_step: str = ""
) -> tuple[bytes, bool]:
    """Compile functions (name -> function, its Numba types) for this processor: object code, and whether it can be kept.

    ValueError for code that calls Python, TypeError for one that returns what `MachineCode.function` cannot.

    With `c_step` = NAME there is a function NAME_c, too: ``int f(void *instance, double t, double h, int)``, the status that NAME of
    (instance, t, h) returns, or -1 if it raises.
    """
    import numba

    types: Any = numba.types
    texts, lasting = [], True
    for name, (function, kinds) in functions.items():
        dispatcher: Any = numba.njit(**options)(function)
        dispatcher.compile(tuple(kinds))
        signature = dispatcher.signatures[0]
        compiled: Any = dispatcher.overloads[signature]
        returned = types.unliteral(compiled.signature.return_type)  # a function may return nothing but 0
        ending = "" if returned in (types.int64, types.none) else f".{returned}"
        if ending not in _RETURNED:
            known = "an integer, a float, a truth value or nothing"
            raise TypeError(f"{function.__module__}.{function.__qualname__} returns {returned}; expected {known}")
        lasting = lasting and not compiled.library.has_dynamic_globals  # addresses of this process, as of a ctypes function
        texts.append((name + ending, compiled.fndesc.llvm_func_name, dispatcher.inspect_llvm(signature)))
    if c_step:
        texts.append((f"{c_step}_c", f"{c_step}_c", _c_step(c_step)))
    module = linked(texts)
    if "numba_gil_ensure" in missing(module):  # Numba sets up what that takes in its own copy of the code only
        raise ValueError(f"{', '.join(functions)}: compiled code calls Python (print?); take that out, or run the model with Model.plain")
    machine = _machine()
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    content: bytes = machine.emit_object(module)
    declared = [v.name for v in (*module.functions, *module.global_variables) if v.is_declaration]
    return content, lasting and all(re.match(ANYWHERE, name) for name in declared)


def numba_version() -> str:
    """Version of Numba, which is not imported for that. PackageNotFoundError without Numba."""
    return version("numba")


def linked(modules: Sequence[_Code]) -> Any:
    """One LLVM module out of several. Everything but these functions becomes private or goes."""
    llvm = _llvm()
    whole = llvm.parse_assembly("")
    public = [new for new, _, _ in modules]
    for new, old, text in modules:
        module = llvm.parse_assembly(without_target(text))
        module.get_function(old).name = new
        whole.link_in(module)
    for value in (*whole.functions, *whole.global_variables):
        if not value.is_declaration and value.name not in public:
            value.linkage = "internal"
    machine = llvm.Target.from_default_triple().create_target_machine()
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    passes.add_strip_symbols_pass()
    passes.run(whole, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0)))
    return whole


def missing(module: Any) -> list[str]:
    """Functions that a module calls and that only exist inside Python."""
    return sorted({f.name for f in module.functions if f.is_declaration and f.name.startswith(FORBIDDEN)})


def without_target(text: str) -> str:
    """Assembly without what names a machine or the order in which things were compiled (comments, scopes of inlined functions)."""
    text = re.sub(r"(?m)^(?:target (?:datalayout|triple) =|source_filename =|; ModuleID =).*\n", "", text)
    return re.sub(r'!"_ZN[^"]*"', '!"scope"', text)


def _llvm() -> Any:
    from llvmlite import binding

    if not hasattr(binding.newpassmanagers.ModulePassManager, "add_strip_symbols_pass"):
        raise ImportError(f"llvmlite {version('llvmlite')} is installed, which comes with Numba before 0.62; update Numba")
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding


def _machine() -> Any:
    """What Numba compiles for: this processor, code that runs where it is put."""
    return _code_in_place(cpu=_llvm().get_host_cpu_name(), features=_features(), opt=3)


def _loader() -> Any:
    """What loads code that is compiled already: LLVM compiles an empty module with it, which optimising would only delay."""
    return _code_in_place(opt=0)


def _code_in_place(**options: Any) -> Any:
    target = _llvm().Target.from_default_triple()
    reloc = "static" if target.name.startswith("x86") else "default"
    return target.create_target_machine(reloc=reloc, codemodel="jitdefault", jit=True, **options)


@cache
def _features() -> str:
    try:
        features: str = _llvm().get_host_cpu_features().flatten()
    except RuntimeError:  # LLVM cannot tell them on this system
        return ""
    return features


@cache
def _target() -> str:
    """A short name of the processor, of the compilers and of Python, whose pickles the code holds."""
    llvm = _llvm()
    processor = f"{llvm.get_default_triple()} {llvm.get_host_cpu_name()} {_features()}"
    return hashlib.sha256(f"{llvm.llvm_version_info} {numba_version()} {sys.version} {processor}".encode()).hexdigest()[:8]


def _c_step(name: str) -> str:
    """LLVM assembly of NAME_c."""
    from llvmlite import ir

    whole, number, double, pointer = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.PointerType(ir.IntType(8))
    module = ir.Module()
    called = ir.Function(module, ir.FunctionType(whole, [number.as_pointer(), pointer.as_pointer(), pointer, double, double]), name)
    function = ir.Function(module, ir.FunctionType(whole, [pointer, double, double, whole]), f"{name}_c")
    builder = ir.IRBuilder(function.append_basic_block())
    returned, raised = builder.alloca(number), builder.alloca(pointer)
    failed = builder.call(called, [returned, raised, *function.args[:3]])
    status = builder.trunc(builder.load(returned), whole)
    builder.ret(builder.select(builder.icmp_signed("==", failed, whole(0)), status, whole(-1)))
    return str(module)
