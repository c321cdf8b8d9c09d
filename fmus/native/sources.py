"""sources/ of a source-code FMU: C99 and C11 that any compiler turns into the library, and how.

The model is written as C from its LLVM code (`c_code.py`); `fmu.c`, `component.h` and `data.c` are those of the libraries. All names
begin with that of the component, as the standard wants it for sources, so that several FMUs can be linked into one program. For a
shared library the importer defines FMI2_OVERRIDE_FUNCTION_PREFIX or FMI3_OVERRIDE_FUNCTION_PREFIX.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement

from robomill.fmus.model_description import xml_file
from robomill.fmus.native.c_code import model_c

FILES = ("fmu.c", "data.c", "model.c")
"""What is compiled."""
_OVERRIDE = "FMI3_OVERRIDE_FUNCTION_PREFIX"


def source_files(name: str, code: str, sources: Mapping[str, bytes]) -> dict[str, bytes]:
    """sources/ of the archive but for the build description: the model's LLVM code as C, and the C files of the library."""
    made = {**sources, "model.c": model_c(code), "prefix.h": _prefix(name, _shared(sources["component.h"].decode()))}
    made["component.h"] = b'#include "prefix.h"\n' + sources["component.h"]
    return {f"sources/{file}": content for file, content in made.items()}


def build_description(name: str) -> bytes:
    """sources/buildDescription.xml of FMI 3.0 as UTF-8."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = SubElement(configuration, "SourceFileSet", language="C11")
    for file in FILES:
        SubElement(files, "SourceFile", name=file)
    why = "Names without the model identifier, for a shared library"
    SubElement(files, "PreprocessorDefinition", name=_OVERRIDE, optional="true", value="1", description=why)
    SubElement(configuration, "Library", name="m", external="true", description="sqrt, floor, ceil of the C library")
    return xml_file(root)


def _shared(header: str) -> list[str]:
    """Names that one C file defines and another uses."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.S)
    names: list[str] = []
    for declaration in re.findall(r"(?m)^(?:extern|int32_t) [^;]*;", text):
        names += re.findall(r"\b([A-Z_]{2,}|model_\w+)\b", declaration)
    return names


def _prefix(name: str, shared: list[str]) -> bytes:
    renamed = "\n".join(f"#define {n} {name}_{n}" for n in shared)
    return f"""/* Names of a source-code FMU: those of FMI begin with the model identifier unless a shared library is made. */
#if !defined(FMI2_OVERRIDE_FUNCTION_PREFIX) && !defined({_OVERRIDE})
#define FULL_NAME(NAME) {name}_##NAME
#endif
{renamed}
""".encode()
