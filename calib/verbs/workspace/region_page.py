"""The page of a region: its voxels as coloured points around the nominal robot, in bands by density."""

from __future__ import annotations

import itertools

import meshcat
import numpy as np
from meshcat import geometry as mc

from calib.basics.arrays import Array
from calib.show.look import ESTIMATION, LITTLE_TO_MUCH, NOMINAL, VALIDATION
from calib.show.scene.html_page import LegendEntry, Page
from calib.show.scene.posed_robot import translation
from calib.show.scene.scene import (
    Dots,
    draw_cloud,
    draw_dots,
    single_page,
    solid,
)
from calib.verbs.workspace.region_picture import headings
from calib.verbs.workspace.region_rows import RegionView

#: Radius of the ball of the target, and of the ball of a row of a table, as shares of the scene's size.
_BALL = 0.008
_ROW_BALL = 0.007

#: Shares of the samples at which the bands of a region end, as far as the region goes.
_BANDS = (0.5, 0.8)

#: A last band narrower than this share is joined with the one before.
_LEAST_BAND = 0.02

#: Number of voxels above which they are thinned out at random.
_MOST_POINTS = 60_000

#: Approximate number of voxels by which the page's camera is placed.
_CAMERA_POINTS = 5000

#: Edge of a point, as a share of a voxel's: small enough to see the robot between them.
_POINT = 0.09


def region_page(view: RegionView) -> Page:
    """Make the page of a region around the nominal robot, in bands by the density of the target's positions."""
    q = view.ranges.mean(axis=1)
    target = (view.robot.poses(q)[0] @ np.append(view.target, 1.0))[:3]
    centres = view.region.points
    title, text = headings(view)

    def draw(scene: meshcat.Visualizer, size: float) -> list[LegendEntry]:
        """Draw target, region and rows in a scene of a size [m], and return their entries of the legend."""
        node = scene["nominal"]["target"]
        node.set_object(mc.Sphere(_BALL * size), solid(NOMINAL))
        node.set_transform(translation(target))
        keys = _draw_voxels(scene, view, centres)
        if view.checked is not None:
            rows, points, _ = view.checked
            dots = (
                Dots("estimation", ESTIMATION, "estimation rows", points[rows.estimation]),
                Dots("validation", VALIDATION, "validation rows", points[rows.validation]),
            )
            keys += draw_dots(scene, dots, _ROW_BALL * size)
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


def _draw_voxels(scene: meshcat.Visualizer, view: RegionView, centres: Array) -> list[LegendEntry]:
    """Draw the voxels of a region, whose centres in the base are (K, 3) [m], in bands by density, the densest first.

    Of more than `_MOST_POINTS` a random choice is drawn. Returns the legend's entry of each band that has a voxel.
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
            keys.append(LegendEntry(f"{prefix} {100 * end:.3g} %", colour, f"band{i}"))
    return keys
