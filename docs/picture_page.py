"""The page of all pictures, docs/pictures.md, from the table here: `python -m docs.picture_page` writes it.

`tests/docs/test_picture_page.py` holds that the page is as the table says, and that every function that draws is in the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

PAGE = Path(__file__).parent / "pictures.md"


@dataclass(frozen=True)
class Picture:
    """A kind of picture."""

    title: str
    functions: tuple[str, ...]
    """`file:function` that draws it; a folder stands for all that is drawn in it."""
    written: str
    """The file, below the folder of the results; of pages of the docs the picture itself."""
    question: str
    reading: str
    """How it is read: what colours and areas are."""
    examples: tuple[str, ...] = ()
    """Pictures of docs/, relative to it."""
    page: str = ""
    """The page that explains what is shown, relative to docs/."""


@dataclass(frozen=True)
class Group:
    """Pictures of one command."""

    title: str
    command: str
    pictures: tuple[Picture, ...]


GROUPS = (
    Group(
        "A milled part",
        "robomill run SCENARIO (kind milling); `--no-pictures` skips them",
        (
            Picture(
                "Maps of the surface",
                ("cell/pictures.py:surfaces",),
                "surfaces.png, VARIANT/surface.png",
                "Where is how much material left or gouged, and which variant is better?",
                "From above; walls are folded outwards. Red: material left; blue: gouged; yellow: beside an edge, not counted.",
                ("pictures/test_part.png", "pictures/groove_surfaces.png"),
                "explanation/validation.md",
            ),
            Picture(
                "Deviation along the path",
                ("cell/pictures.py:deviations",),
                "deviation.png",
                "When does the tool leave its path, and does the compensation come late?",
                "Sideways and along the tool axis. Grey: the cutter is engaged; light blue and orange: it enters and leaves.",
                ("pictures/deviation.png",),
                "explanation/validation.md",
            ),
            Picture(
                "Force signals",
                ("cell/pictures.py:forces",),
                "VARIANT/force.png",
                "What does the controller know of the force, and how late?",
                "Thick grey: the cutting force; the others are what sensor, pilot and controller make of it. Grey area: engaged.",
                ("pictures/force.png",),
                "explanation/validation.md",
            ),
            Picture(
                "Correction and projection",
                ("cell/pictures.py:projection",),
                "VARIANT/projection.png",
                "Which part of the correction is used, and which is left out because it points along the feed?",
                "Left: the correction in the base, before and after the projection. Right: from above, corrections ten times as long.",
                ("pictures/projection.png",),
                "explanation/validation.md",
            ),
            Picture(
                "The part in space",
                ("cell/part_picture.py:draw",),
                "VARIANT/part.png (cells with tri-dexels)",
                "What does the machined part look like, and where is it off?",
                "Coloured is what the tool made: red is material left, blue is gouged. Grey is the raw part.",
                ("pictures/tilted_ball.png",),
                "how_to/workpiece.md",
            ),
            Picture(
                "Scan of a faced block: lines",
                ("cell/scan.py:profiles",),
                "scan_profile.png (scenarios with [scan])",
                "How much too deep is the faced surface along its middle?",
                "One line for each variant; 0 is the programmed plane.",
                ("pictures/deformation_end_milling.png",),
                "explanation/deformation.md",
            ),
            Picture(
                "Scan of a faced block: map",
                ("cell/scan.py:maps",),
                "scan_map.png (scenarios with [scan])",
                "Where would a tool that is brought closer touch first, and where last?",
                "Bright is too deep. White is not scanned: openings of the part.",
                ("pictures/deformation_cylinder_head.png",),
                "explanation/deformation.md",
            ),
            Picture(
                "Static load cases",
                ("cell/pictures.py:load_cases",),
                "load_cases.png (kind static_loads)",
                "How far does a load push the tool, by direction and place, and what is left of that with compensation?",
                "A bar for each case and variant; dashed lines are means that the paper gives.",
                ("pictures/load_cases.png",),
                "explanation/validation.md",
            ),
            Picture(
                "In space and time",
                (),
                "view.html, by `robomill view RUN`",
                "What happens when, and where does the robot bend?",
                "A page, not a picture: see the viewer.",
                ("pictures/viewer_part.png", "pictures/viewer_bending.png"),
                "how_to/viewer.md",
            ),
        ),
    ),
    Group(
        "Controlled material removal rate",
        "robomill run SCENARIO (kind removal_rate)",
        (
            Picture(
                "Force and feed over time",
                ("cell/rate_pictures.py:force_and_feed",),
                "VARIANT/force_and_feed.png",
                "Does the controller hold the force, and is the loop stable at every depth?",
                "Grey area: depth of cut (right axis). Thin grey lines: force as measured, feed as commanded.",
                ("pictures/step_depth_fixed.png", "pictures/step_depth_selftuning.png", "pictures/deburring_two_stages.png"),
                "explanation/force_control.md",
            ),
            Picture(
                "Force over the way",
                ("cell/rate_pictures.py:over_way",),
                "force_over_way.png (several variants)",
                "Which variant is faster at the same limit of the force?",
                "Below: the depth of cut along the way.",
                ("pictures/force_over_way.png",),
                "explanation/force_control.md",
            ),
        ),
    ),
    Group(
        "Path learning",
        "robomill run SCENARIO (kind path_learning)",
        (
            Picture(
                "Learnt path",
                ("cell/learning_pictures.py:passes",),
                "VARIANT/learnt.png",
                "How close does the learnt path come to the true edge, and does another pass help?",
                "Grey band: the edge as drawn. Below: what is left between learnt and true path. Closed contours have a detail.",
                ("pictures/path_learning.png", "pictures/pump_groove.png"),
                "explanation/path_learning.md",
            ),
        ),
    ),
    Group(
        "Offline compensation and placement",
        "robomill compensate, robomill place",
        (
            Picture(
                "Maps before and after",
                ("cell/compensation_pictures.py:maps",),
                "maps.png",
                "What does the corrected program leave on the part?",
                "As the maps of the surface; first the nominal part with its depths in grey.",
                ("pictures/offline_maps.png",),
                "how_to/offline_compensation.md",
            ),
            Picture(
                "Along the path",
                ("cell/compensation_pictures.py:path",),
                "path.png",
                "Has the iteration converged, and does the program still help on a machine that is other than simulated?",
                "Dark: uncompensated, green: compensated. Numbers at the iterations: what is left of the step before.",
                ("pictures/offline_path.png",),
                "how_to/offline_compensation.md",
            ),
            Picture(
                "Criterion of the placement",
                ("cell/placement_pictures.py:draw",),
                "place.png",
                "Where do workpiece and spindle bend the robot least, and how flat is that optimum?",
                "Dark is good. Grey: the robot cannot reach it, or not within its limits.",
                ("pictures/place.png",),
                "how_to/offline_compensation.md",
            ),
        ),
    ),
    Group(
        "Stability",
        "robomill stability SCENARIO, `--map`",
        (
            Picture(
                "Lobes",
                ("cell/stability_pictures.py:draw_lobes",),
                "stability_lobes.png",
                "Does a planned cut chatter, and which speed would be better?",
                "Below a line the cut is stable. Dashed: without modes of the spindle. Lines on each other have different widths.",
                ("pictures/stability_lobes.png",),
                "how_to/stability.md",
            ),
            Picture(
                "Map of the margin",
                ("cell/stability_pictures.py:draw_map",),
                "stability_map.png",
                "Would the same cut be stable elsewhere in the work space?",
                "Margin: limit over planned depth; 1 is the limit. Grey: out of reach.",
                ("pictures/stability_map.png",),
                "how_to/stability.md",
            ),
        ),
    ),
    Group(
        "Identification",
        "robomill identify cycle|stations|hammer|sensor|cubes, `--out DIR`",
        (
            Picture(
                "Loop of an axis",
                ("robomill/identify_cycle.py:draw_cycle",),
                "NAME.png",
                "How stiff is an axis, and how wide is its hysteresis?",
                "Grey: measured. The three lines are the slopes that are reported.",
                ("pictures/identify_cycle.png",),
                "how_to/identify.md",
            ),
            Picture(
                "Gap of an axis",
                ("robomill/identify_cycle.py:draw_gap",),
                "NAME.png (small cycles)",
                "How large is the backlash, and how sure is that?",
                "Right: the angle without the spring. Red lines: the gap; red bands: its interval.",
                ("pictures/identify_backlash.png",),
                "how_to/identify.md",
            ),
            Picture(
                "Stiffness at stations",
                ("robomill/identify_stations.py:draw",),
                "stations.png",
                "How much softer is the robot than its drives?",
                "White bars: the drives alone. Blue: with the tilt of the axes. Grey: measured.",
                ("pictures/identify_stations.png",),
                "how_to/identify.md",
            ),
            Picture(
                "Responses to blows",
                ("robomill/identify_pictures.py:draw_responses",),
                "responses.png",
                "At which frequencies does the tool vibrate, and does the fit hold?",
                "Thick grey: measured; blue: fitted; dotted: the modes. Below: coherence, near 1 where the measurement can be trusted.",
                ("pictures/identify_hammer.png",),
                "how_to/identify.md",
            ),
            Picture(
                "Mode shapes",
                ("robomill/identify_pictures.py:draw_shapes",),
                "shapes.png",
                "Which axes move in a mode?",
                "Black: still; blue: the ends of the vibration; grey: between them. The title names the axes that move most.",
                ("pictures/identify_modes.png",),
                "how_to/identify.md",
            ),
            Picture(
                "Calibration of a sensor",
                ("robomill/identify_sensor.py:_plot",),
                "FILE of `--plot`",
                "How well does the identified matrix give the force, by direction?",
                "Above: shown over applied force. Below: their difference.",
                ("pictures/identify_sensor.png",),
                "explanation/spindle_holder.md",
            ),
            Picture(
                "Springs from cubes",
                ("robomill/identify_cubes.py:draw",),
                "cubes.png",
                "Which springs do these loads determine, and by which way of evaluation?",
                "Above: standard deviations, and the limit from which a spring is called vague. Below: identified over given.",
                ("pictures/cubes.png",),
                "how_to/identify.md",
            ),
        ),
    ),
    Group(
        "Any run, from Python",
        '`Run.plot`, as in `rm.run("groove")["cartesian"].plot("sensor.f_T_T")`',
        (
            Picture(
                "Signals over time",
                ("orchestration/runs/picture.py:draw",),
                "shown in a notebook; `savefig` writes it",
                "What do these signals of a run do?",
                "A panel for each signal, a line for each of its elements.",
                (),
                "how_to/python.md",
            ),
        ),
    ),
    Group(
        "Diagnosis",
        "robomill diagnose SYSTEM RUN...",
        (
            Picture(
                "Figures of the report",
                ("robomill/report",),
                "report.html, figures/*.svg, figures/*.png",
                "Where do machine and simulation differ, which effect is it, and how far does it close the gap?",
                "Each has its caption in the report. Grey bands are what repeats of the same run differ by.",
                ("pictures/report.png",),
                "explanation/diagnosis.md",
            ),
        ),
    ),
    Group(
        "Studies of the documentation",
        "the script that is named with each",
        (
            Picture(
                "Lead time of the pilot force",
                ("docs/studies.py:lead_time",),
                "docs/figures/lead_time.png",
                "How early must the force be known?",
                "Blue, left axis: deviation. Red, right axis: reaction.",
                ("figures/lead_time.png",),
                "explanation/validation.md",
            ),
            Picture(
                "Communication step",
                ("docs/studies.py:convergence",),
                "docs/figures/convergence.png",
                "How much does the coupling of force and deflection depend on the step of the master?",
                "Differences of the deflection between two ways, both axes logarithmic.",
                ("figures/convergence.png",),
                "explanation/validation.md",
            ),
            Picture(
                "Root loci",
                ("docs/rate_studies.py:root_loci",),
                "docs/pictures/rate_root_locus.png",
                "At which depth of cut does the force control become unstable?",
                "Left: the s plane, stable is left of 0. Right: the z plane, stable is within the circle.",
                ("pictures/rate_root_locus.png",),
                "explanation/rate_control.md",
            ),
            Picture(
                "Step responses of the force control",
                ("docs/rate_studies.py:steps",),
                "docs/pictures/rate_steps.png",
                "What does a step of the reference look like at 1, 2 and 3 mm with the gains of 1 mm?",
                "Lines on each other have different styles.",
                ("pictures/rate_steps.png",),
                "explanation/rate_control.md",
            ),
            Picture(
                "Damping of the force control",
                ("docs/rate_studies.py:dampings",),
                "docs/pictures/rate_damping.png",
                "What does each delayed step cost?",
                "Below 0 the loop is unstable. Vertical lines: the gains at 1, 2 and 3 mm.",
                ("pictures/rate_damping.png",),
                "explanation/rate_control.md",
            ),
            Picture(
                "Budget of the spindle holder",
                ("docs/holder_study.py:draw_budget",),
                "docs/pictures/spindle_holder_budget.png",
                "Which cause limits the compensation with the instrumented spindle holder?",
                "Two standard deviations of what is left, by cause. No bar: this cause does not act there.",
                ("pictures/spindle_holder_budget.png",),
                "explanation/spindle_holder.md",
            ),
            Picture(
                "Angle of the spindle",
                ("docs/holder_study.py:draw_orientation",),
                "docs/pictures/spindle_orientation.png",
                "How much less does the robot bend with the spindle at 55 degrees?",
                "Grey: out of reach.",
                ("pictures/spindle_orientation.png",),
                "explanation/spindle_holder.md",
            ),
            Picture(
                "Overcut by direction of feed",
                ("docs/deformation_study.py:main",),
                "docs/pictures/deformation_directions.png",
                "In which direction does the tool dig in, and where does it climb?",
                "Crosses: an independent calculation.",
                ("pictures/deformation_directions.png",),
                "explanation/deformation.md",
            ),
            Picture(
                "Failures of the link",
                ("docs/rsi_study.py",),
                "docs/pictures/rsi_failures.png",
                "What does the robot get when packets are lost, late or wrong?",
                "The correction is led back to zero along a ramp.",
                ("pictures/rsi_failures.png",),
                "how_to/rsi.md",
            ),
            Picture(
                "Masters side by side",
                ("benchmarks/report.py:_figure",),
                "docs/benchmarks/masters.png, scaling.png (`make bench`)",
                "What does a step cost in which master, and how does that grow?",
                "Medians; thin lines: the spread. All axes of time are logarithmic.",
                ("benchmarks/masters.png", "benchmarks/scaling.png"),
                "benchmarks/masters.md",
            ),
        ),
    ),
)


def page() -> str:
    """The text of docs/pictures.md."""
    lines = [
        "# Pictures",
        "",
        "Every kind of picture that robomill makes: by which command, and which question it answers.",
        "Colours are told apart with any colour vision (Okabe & Ito); maps of deviations are red and blue about white.",
        "",
    ]
    for group in GROUPS:
        lines += [f"## {group.title}", f"Made by: {group.command}.", ""]
        for p in group.pictures:
            lines += [f"### {p.title}", f"**{p.question}**", "", p.reading, ""]
            drawn = f" Drawn by {', '.join(f'`{f}`' for f in p.functions)}." if p.functions else ""
            lines += [f"File: {p.written}.{drawn} More: [{p.page}]({p.page}).", ""]
            lines += [line for e in p.examples for line in (f"![{p.title}]({e})", "")]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
