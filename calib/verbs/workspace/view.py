"""The page of a region: its voxels as coloured points about the nominal robot, in bands by density."""

from __future__ import annotations

import itertools

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.basics.arrays import Array
from calib.show.figure_base import ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.show.scene.html_page import Key, Page
from calib.show.scene.posed_robot import translation
from calib.show.scene.scene import (
    Dots,
    draw_cloud,
    draw_dots,
    single_page,
    solid,
)
from calib.verbs.workspace.figures import headings
from calib.verbs.workspace.region_rows import RegionView

#: Radius of the ball of a target, as a part of the scene's size.
_BALL = 0.008

#: Radius of the ball of a row of a table, as a part of the scene's size.
_ROW_BALL = 0.007


#: Shares of the samples at which the bands of a region end, as far as the region goes.
_BANDS = (0.5, 0.8)


#: A band narrower than this share is joined with the next one.
_LEAST_BAND = 0.02


#: More voxels than this are thinned out, evenly.
_MOST_POINTS = 60_000


#: Voxels, about, that the camera is placed by.
_CAMERA_POINTS = 5000


#: Edge of a point, as a part of a voxel; the robot is seen between them.
_POINT = 0.09


def region_page(view: RegionView) -> Page:
    """Make the page of a region about the nominal robot, in bands by the density of the target's positions."""
    q = view.ranges.mean(axis=1)
    target = (view.robot.poses(q)[0] @ np.append(view.target, 1.0))[:3]
    centres = view.region.origin + view.region.voxel * (np.argwhere(view.region.cells) + 0.5)
    title, text = headings(view)

    def draw(scene: meshcat.Visualizer, size: float) -> list[Key]:
        node = scene["nominal"]["target"]
        node.set_object(mc.Sphere(_BALL * size), solid(NOMINAL))
        node.set_transform(translation(target))
        keys = _draw_voxels(scene, view, centres)
        keys += draw_dots(scene, _row_dots(view), _ROW_BALL * size)
        return keys

    return single_page(
        view.robot,
        q,
        np.concatenate([target[None], centres[:: 1 + len(centres) // _CAMERA_POINTS]]),
        draw,
        title=title,
        text=text,
        legend=f"{view.robot.name}, nominal",
    )


def _row_dots(view: RegionView) -> tuple[Dots, ...]:
    """Return the points of a table's rows by set; none without a table."""
    if view.checked is None:
        return ()
    rows, points, _ = view.checked
    return (
        Dots("estimation", ESTIMATION, "estimation rows", points[rows.estimation]),
        Dots("validation", VALIDATION, "validation rows", points[rows.validation]),
    )


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView, centres: Array) -> list[Key]:
    """Draw the voxels of a region in bands by density.

    Args:
        scene: Node of the scene.
        view: The region.
        centres: shape (K, 3), middles of its voxels in the base [m].

    Returns:
        The entries of the legend, the densest band first.
    """
    share_of = view.density.share_of(centres)
    chosen = np.sort(np.random.default_rng(0).permutation(len(centres))[:_MOST_POINTS])
    centres = centres[chosen]
    share_of = share_of[chosen]
    share = view.region.share
    inner = [end for end in _BANDS if end < share - _LEAST_BAND]
    keys = []
    for i, (start, end) in enumerate(itertools.pairwise([0.0, *inner, share])):
        colour = LITTLE_TO_MUCH[len(LITTLE_TO_MUCH) - 1 - i]
        band = (share_of > start) & ((share_of <= end) | (end == share))
        if band.any():
            draw_cloud(scene[f"band{i}"], centres[band], colour, _POINT * view.region.voxel)
            prefix = "the densest" if i == 0 else "up to"
            keys.append(Key(f"{prefix} {100 * end:.3g} %", colour, f"band{i}"))
    return keys
