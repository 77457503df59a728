"""A region in the browser: its voxels as coloured points about the nominal robot, in one HTML file.

The voxels stand in bands by how often the target is there; each band can be hidden.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import meshcat
import numpy as np
from meshcat import geometry as mc
from numpy.typing import NDArray

from calib.design.region import Region
from calib.design.workspace import Density
from calib.model.robot import Robot
from calib.show.figure_region import Marked
from calib.show.page import Key, single_page
from calib.show.rows import ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.show.scene import Page, draw_cloud, draw_points, solid, translation

Array = NDArray[np.float64]

#: The bands end at these shares, as far as the region goes.
_BANDS = (0.5, 0.8)

#: More voxels than this are thinned out, evenly; fewer than the other number get more than one point each.
_MOST_POINTS, _WANTED_POINTS = 60_000, 15_000

#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.36

#: Radius of the target's ball and of a row's, as a part of the scene's size.
_BALL, _SMALL_BALL = 0.011, 0.007


@dataclass(frozen=True, slots=True, eq=False)
class RegionView:
    """What is shown.

    Attributes:
        robot: The nominal robot.
        q: shape (m,), [rad] or [m], how it stands.
        target: shape (3,), in the tip [m].
        density: The density.
        region: A region of it.
        title: The page's heading, plain text.
        text: Sentences below it, plain text.
        marked: Points of a table; None for none.

    Raises:
        ModelError: The pose or the target has another shape or is not finite.
    """

    robot: Robot
    q: Array
    target: Array
    density: Density
    region: Region
    title: str
    text: str = ""
    marked: Marked | None = None


def write_region_view(view: RegionView, path: str | Path, *, overwrite: bool = False) -> Path:
    """Write a region as one HTML file that opens from disk without a network.

    Raises:
        FileError: The file exists and ``overwrite`` is False, or it cannot be written.
    """
    return region_page(view).write(path, overwrite=overwrite)


def region_page(view: RegionView) -> Page:
    """Draw a region.

    Raises:
        UrdfError: Pinocchio cannot build a model of the URDF.
    """
    T_tip = view.robot.poses(view.q)[0]
    target = T_tip[:3, :3] @ view.target + T_tip[:3, 3]
    centres = _centres(view.density, view.region.cells)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        if np.any(view.target):
            node = scene["nominal"]["target"]
            node.set_object(mc.Sphere(_BALL * size), solid(NOMINAL))
            node.set_transform(translation(target))
        return [*_draw_voxels(scene, view), *_draw_rows(scene, view, size)]

    return single_page(
        view.robot,
        view.q,
        np.concatenate([target[None], centres[:: 1 + len(centres) // 5000]]),
        draw,
        title=view.title,
        text=view.text,
        legend=f"{view.robot.name}, nominal",
    )


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView) -> list[Key]:
    """The region's voxels in bands, and their lines of the legend."""
    centres = _centres(view.density, view.region.cells)
    # The centre of a voxel may lie beyond the box that cuts it.
    needed = view.density.share_of(np.clip(centres, *view.region.box))
    inside = np.ones(len(centres), dtype=np.bool_)
    rng = np.random.default_rng(0)
    if len(centres) > _MOST_POINTS:
        chosen = rng.permutation(len(centres))[:_MOST_POINTS]
        inside &= np.isin(np.arange(len(centres)), chosen)
    copies = max(1, _WANTED_POINTS // len(centres))
    centres, needed = np.repeat(centres, copies, axis=0), np.repeat(needed, copies)
    inside = np.repeat(inside, copies)
    edge = _POINT * view.density.voxel / np.cbrt(copies)
    # Anywhere in its voxel: points in rows would make patterns of their own.
    centres = centres + view.density.voxel * rng.uniform(-0.5, 0.5, centres.shape)
    inside &= np.all((centres >= view.region.box[0]) & (centres <= view.region.box[1]), axis=1)
    share = view.region.share
    ends = [0.0, *[end for end in _BANDS if end < share - 0.02], share]
    keys = []
    for i, (start, end) in enumerate(itertools.pairwise(ends)):
        colour = LITTLE_TO_MUCH[len(LITTLE_TO_MUCH) - 1 - i]
        last = end == share
        band = inside & (needed > start) & ((needed <= end) | last)
        points = centres[band]
        if not len(points):
            continue
        draw_cloud(scene[f"band{i}"], points, colour, edge)
        words = f"the densest {100 * end:.3g} %" if i == 0 else f"up to {100 * end:.3g} %"
        keys.append(Key(words, colour, f"band{i}"))
    return keys


def _draw_rows(scene: meshcat.Visualizer, view: RegionView, size: float) -> list[Key]:
    """The points of a table, and their lines of the legend."""
    if view.marked is None:
        return []
    keys = []
    for chosen, colour, word in (
        (~view.marked.validation, ESTIMATION, "estimation"),
        (view.marked.validation, VALIDATION, "validation"),
    ):
        points = view.marked.points[chosen]
        # A wild point is not looked for at the end of the world.
        points = points[np.linalg.norm(points, axis=1) < 5.0 * size]
        if not len(points):
            continue
        draw_points(scene[word], points, colour, _SMALL_BALL * size)
        keys.append(Key(f"{word} rows", colour, word, "dot"))
    return keys


def _centres(density: Density, cells: NDArray[np.bool_]) -> Array:
    """Centres of voxels, shape (K, 3), [m]."""
    result: Array = density.origin + density.voxel * (np.argwhere(cells) + 0.5)
    return result
