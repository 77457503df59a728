"""The HTML page about a scene: heading, legend, controls, and the scripts that may run. Every name is escaped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshcat
import numpy as np
from numpy.typing import NDArray

from calib.model.robot import Robot
from calib.show.camera import look_at, round_length, row_direction
from calib.show.palette import CALIBRATED, MEASURED, NOMINAL
from calib.show.puppet import Puppet, span, stage_poses
from calib.show.scene import SCENE, Page, draw_puppet, draw_stage, new_scene, translation
from calib.show.shapes import read_visuals
from calib.show.window import as_base64, viewer_licences, viewer_script

Array = NDArray[np.float64]

#: The colours of robots and of what was measured.
COLOURS = {"nominal": NOMINAL, "calibrated": CALIBRATED, "measured": MEASURED}

#: What a page may talk to that came from a server on this computer.
_LIVE = "; connect-src 'self' ws://127.0.0.1:* ws://localhost:*"


@dataclass(frozen=True, slots=True)
class Key:
    """A line of the legend that shows and hides a part of the scene.

    Attributes:
        text: What it is.
        colour: As CSS has it.
        nodes: Which nodes below `SCENE`, blanks between them.
        kind: ``"dot"`` for a round mark, and others of the style sheet.
        on: Whether it is shown at first.
    """

    text: str
    colour: str
    nodes: str
    kind: str = ""
    on: bool = True


def filled_page(
    template: str,
    scene: bytes,
    *,
    table: Mapping[str, Any] | None = None,
    scripts: Sequence[str] = (),
    live: bool = False,
    **content: Any,  # noqa: ANN401  what the template names
) -> bytes:
    """The page about a scene, UTF-8.

    Args:
        template: ``"page.html"``, or one that extends it.
        scene: The scene's message.
        table: What the page's own script is told; None for a page without one.
        scripts: Names of that script's files.
        live: Whether the page listens to the server that it came from.
        content: What the template is filled with: ``title``, ``text``, ``keys``, ``grid`` and ``warnings`` at least.
    """
    import jinja2
    from markupsafe import Markup

    folder = Path(__file__).parent
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    texts = [viewer_script(), (folder / "page.js").read_text(encoding="utf-8")]
    if scripts:
        own = "\n".join((folder / name).read_text(encoding="utf-8") for name in scripts)
        texts.append(f'"use strict";\n(() => {{\n{own}}})();\n')
    texts = [_no_end_tag(text) for text in texts]
    hashes = " ".join(f"'sha256-{_hash(text)}'" for text in texts) + (_LIVE if live else "")
    # A block of JSON that no name in it can end.
    told = json.dumps(table, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    page = environment.get_template(template).render(
        hashes=Markup(hashes),
        live=live,
        colours=COLOURS,
        licences=Markup(_no_end_tag(viewer_licences())),
        scene=as_base64(scene),
        table=Markup(told) if table else "",
        scripts=[Markup(text) for text in texts],
        **content,
    )
    return page.encode("utf-8", "replace")


def single_page(
    robot: Robot,
    q: Array,
    points: Array,
    draw: Callable[[meshcat.Visualizer, float], list[Key]],
    *,
    title: str,
    text: str,
    legend: str,
) -> Page:
    """A page of one robot at one pose, and what else is drawn about it.

    Args:
        robot: The robot.
        q: shape (m,), [rad] or [m], how it stands.
        points: shape (K, 3), in the base, of what else is to be seen [m].
        draw: Draws below the node given, in the base frame, things about as large as the size given [m], and returns
            their lines of the legend.
        title: The heading.
        text: Sentences below it.
        legend: What the legend says of the robot.

    Raises:
        UrdfError: Pinocchio cannot build a model of the URDF.
    """
    visuals, warnings = read_visuals(robot.urdf)
    puppet = Puppet.of(robot, q[None], visuals, np.eye(4)[None], np.eye(4))
    upright = np.eye(4)
    upright[:3, :3] = stage_poses(robot, q[None])[0, :3, :3]
    drawn = puppet.outline(0) @ upright[:3, :3].T
    everything = np.concatenate([drawn, points @ upright[:3, :3].T])
    size, grid = span(everything), round_length(span(everything) / 7.0)
    camera = look_at(everything, row_direction(puppet.origins[0] @ upright[:3, :3].T))
    window, root = new_scene()
    floor = float(drawn[:, 2].min())
    draw_stage(root, camera, size=size, floor=floor, grid=grid, through=np.zeros(3))
    root[SCENE].set_transform(translation(-camera.centre) @ upright)
    draw_puppet(root[SCENE]["nominal"], puppet, 0, NOMINAL, 0.0, front=False)
    keys = [Key(legend, NOMINAL, "nominal"), *draw(root[SCENE], size)]
    html = filled_page(
        "page.html", window.scene(), title=title, text=text, keys=keys, grid=grid, warnings=warnings
    )
    return Page(html, tuple(warnings))


def _no_end_tag(text: str) -> str:
    """A script whose strings cannot end it."""
    return text.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _hash(script: str) -> str:
    """A script's name in the page's policy: no other script runs, whatever a name may hold."""
    return as_base64(hashlib.sha256(script.encode("utf-8")).digest())
