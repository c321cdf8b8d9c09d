"""`robomill diagnose`: what the engine is told about milling cells, and its answer on the screen and on disk."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from diagnosis import adopt
from diagnosis.catalogue import LOGGING, Catalogue
from diagnosis.engine import Menu, diagnose
from orchestration.results import Run
from orchestration.system import System
from robomill.binding import convert, resolve

CATALOGUE = "catalogue.toml"
MENU = Menu(
    titles={
        "compliance.p_BT_B": "tool-tip path error",
        "sensor.f_T_T": "compensated force error",
        "sensor.f_S_raw": "sensor force error",
        "drive.torque_motor": "motor torque error",
        "drive.q_motor": "motor angle error",
        "controller.correction_B": "correction error",
        "milling.spindle_torque": "spindle torque error",
    },
    experiments={
        "free motion": ("friction_viscous", "friction_coulomb", "transmission_error", "tracking_lag", "geometry_error", "inertial_force"),
        "reversals": ("backlash", "reversal_friction", "gear_hysteresis", "friction_coulomb", "friction_stribeck", "tracking_lag"),
        "static loads": ("stiffness_error", "tilt_compliance", "base_compliance", "tool_compliance", "stiffness_asymmetry", "sensor_gain"),
        "static loads with a hanging weight": ("payload_error", "weight_error", "counterbalance_error", "stiffness_error"),
        "force staircase": ("stiffness_hardening", "gear_hysteresis", "dead_band", "clipping", "sensor_gain", "sensor_gain_axis"),
        "sensor poses": ("weight_error", "misalignment", "hose_force", "zero_drift", "cross_talk", "sensor_gain_axis"),
        "second depth": ("tool_wear", "cutting_coefficient", "stock_error", "workpiece_compliance", "correction_limit"),
        "second feed": ("size_effect", "tool_wear", "cutting_coefficient", "tracking_lag", "extra_delay", "sensor_lag"),
        "second direction": ("frame_error", "stiffness_error", "base_compliance", "stiffness_table_error", "engagement_error"),
        "warm-up": ("thermal_growth", "zero_drift"),
        "tap test": ("structural_mode", "tool_compliance", "workpiece_compliance"),
    },
)


def add_arguments(command: Any) -> None:
    """The options of the command."""
    command.add_argument("system", type=Path, metavar="SYSTEM.toml", help="the nominal simulation")
    command.add_argument(
        "runs", type=Path, nargs="+", metavar="RUN", help="folders of measured runs; repeats of one condition belong together"
    )
    command.add_argument("--held-out", type=Path, nargs="+", default=[], metavar="RUN", help="runs that only the closure is measured on")
    command.add_argument("--catalogue", type=Path, metavar="FILE", help="candidate effects (default: catalogue.toml beside the system)")
    command.add_argument("--out", type=Path, default=Path("results") / "diagnosis", metavar="DIR", help="folder for the answer")
    command.add_argument("--repair", action="store_true", help="correct a clock that is late, and diagnose the rest")
    command.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (default: 2)")


def run(options: Namespace) -> int:
    """Exit status 0: answered; 1: the log is not usable."""
    from robomill.commands import _progress

    file = options.catalogue or options.system.parent / CATALOGUE
    if not file.is_file():
        raise FileNotFoundError(f"no catalogue {file}; name one with --catalogue (the milling cell's is scenarios/{CATALOGUE})")
    catalogue, system = Catalogue.load(file), System.load(options.system, convert)
    runs, held = [Run.load(f) for f in options.runs], [Run.load(f) for f in options.held_out]
    with _progress(options.json) as report:
        found = diagnose(
            system,
            runs,
            catalogue,
            held_out=held,
            resolver=resolve,
            convert=convert,
            workers=max(1, options.jobs),
            report=report,
            menu=MENU,
            repair=options.repair,
        )
    options.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found.result, indent=1)
    (options.out / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
    if found.result["verdict"] in ("identified", "ambiguous"):
        adopt.write(found.adopted, options.out / "adopt.ssv")
    else:
        (options.out / "adopt.ssv").unlink(missing_ok=True)  # of an earlier answer
    if options.json:
        print(text)
    else:
        print("\n".join(lines(found.result)))
        print(f"diagnosis.json{' and adopt.ssv are' if (options.out / 'adopt.ssv').is_file() else ' is'} in {options.out}/")
    return 1 if found.result["verdict"] == "bad_log" else 0


def lines(result: dict[str, Any]) -> list[str]:
    """The answer in sentences."""
    out = [f"verdict: {result['verdict']}"]
    out += [f"log: {f['channel']} {f['text']}" for f in result["gate"]["findings"]]
    for w in result["where"]:
        if w["component"] != LOGGING:
            out.append(f"where: {w['component']} ({w['location']}), {100 * w['share']:.0f} % of the gap, strongest in {w['direction']}")
    for w in result["which"][:6]:
        values = ", ".join(
            f"{k} = {v['value']:.4g} [{v['interval'][0]:.4g} .. {v['interval'][1]:.4g}] {v['unit']}" for k, v in w["parameters"].items()
        )
        out.append(f"which: {w['effect']} at {w['location']}, probability {w['probability']:.2f}, {values}")
    for h in result["how_far"]:
        if h["unit"] != "1":
            closed = "not measurable" if h["closure"] is None else f"closure {100 * h['closure']:.0f} %"
            out.append(f"how far: {h['metric']}, {h['on']}: {h['before']:.3g} -> {h['after']:.3g} {h['unit']}, {closed}")
    if result["next_run"]:
        out.append(f"next run: {result['next_run']['kind']}, to separate {', '.join(result['next_run']['separates'])}")
    return out
