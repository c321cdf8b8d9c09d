"""`robomill build`: components as FMUs, systems as SSP packages, all of it as a signed archive."""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from robomill.orchestration.runs.run import Run
from robomill.orchestration.system.definition import System
from robomill.progress import progress_bar

if TYPE_CHECKING:
    from robomill.cell import milling
    from robomill.models.model.declaration import Model

DEFAULT_FMI = 2
"""Version of FMI that is built where none is asked for; Python FMUs know no other."""


def run(options: Namespace) -> int:
    """`robomill build`: FMUs of all or some components, a replay FMU of one of them, or whole systems as SSP packages."""
    from robomill.cell import package as ssp
    from robomill.fmus.components import COMPONENTS, component
    from robomill.fmus.provenance import release
    from robomill.fmus.signed import private_key, write_signed

    key = None if options.sign is None else private_key(options.sign)
    packages: list[System] = []
    if options.ssp is not None:
        packages = ssp.systems(options.ssp, options.out / "tables" / options.ssp.stem, options.variant)
    names = options.component or (ssp.used(packages) if packages else list(COMPONENTS))
    models = [component(name) for name in names]
    if options.replay is not None:
        if len(names) != 1 or not options.component:
            raise ValueError("--replay needs exactly one --component: the one that the recording stands in for")
        models = [_replay_model(Run.load(options.replay), names[0], options.recorded_as or names[0])]
    options.out.mkdir(parents=True, exist_ok=True)
    with progress_bar(options.json) as report:
        files = _build(models, options, report)
        written = ssp.write(packages, options.out, options.out, report)
    signed: list[Path] = []
    if key is not None:
        signed = [options.out / f"robomill-{release()}.zip"]
        write_signed(signed[0], {f.relative_to(options.out).as_posix(): f.read_bytes() for f in (*files, *written)}, key)
    if options.json:
        told = {"fmus": files, "packages": written, **({"archive": signed} if signed else {})}
        print(json.dumps({what: [str(f) for f in found] for what, found in told.items()}))
    else:
        for f in (*files, *written, *signed):
            print(f"{f}  {f.stat().st_size / 1024:.0f} kB")
    return 0


def _build(models: Sequence[Model], options: Namespace, report: milling.Progress) -> list[Path]:
    """FMUs of all models with the backend and for the FMI versions that were asked for."""
    from robomill.fmus.python.builder import build as build_python
    from robomill.fmus.reference import reference_files

    versions = sorted(set(options.fmi or [DEFAULT_FMI]))
    report("build", 0, len(models) * len(versions))
    files: list[Path] = []

    def done(file: Path) -> None:
        files.append(file)
        report("build", len(files), len(models) * len(versions))

    if options.backend == "native":
        from robomill.fmus.native.builder import build_all  # needs LLVM: a second to load

        built: list[Path] = []
        for fmi in versions:
            # the folder itself is where `run --fmus` and the packages, which know no FMI 3, look
            folder = options.out / f"fmi{fmi}" if fmi != DEFAULT_FMI and len(versions) > 1 else options.out
            platforms = tuple(options.platform or ["linux64"])
            built += build_all(
                models,
                folder,
                fmi=fmi,
                platforms=platforms,
                arrays=not options.scalars,
                sources=options.sources,
                reference=lambda m: reference_files(m.name),
                done=done,
            )
        return built
    if versions != [DEFAULT_FMI] or options.platform or options.scalars or options.sources:
        raise ValueError(
            "--fmi 3, --platform, --scalars and --sources go with --backend native; Python FMUs are FMI 2 for linux64 and win64"
        )
    for model in models:
        done(build_python(model, options.out))
    return files


def _replay_model(recorded: Run, component_name: str, recorded_as: str) -> Model:
    """The model that plays back what `recorded_as` did in a run, in place of the component `component_name`."""
    from robomill.fmus.components import component
    from robomill.models.components.recording import replay_model

    model = component(component_name)
    if recorded_as not in recorded.components:
        raise ValueError(
            f"{recorded.folder} has no component {recorded_as!r}; it has {', '.join(recorded.components)}: say which one with --as"
        )
    outputs = [v.name for v in model.variables if v.causality == "output"]
    columns = {name: recorded[f"{recorded_as}.{name}"] for name in outputs}
    return replay_model(model, recorded.t - recorded.t[0], columns)
