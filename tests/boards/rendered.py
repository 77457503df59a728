"""Pictures of boards as a camera would take them, of the rectangles that are printed."""

from __future__ import annotations

import cv2
import numpy as np

from calib.boards.drawing import black_rectangles

#: Where the pattern's corners are in the picture, as shares of its width and height: seen from the side.
TILTED = ((0.17, 0.16), (0.86, 0.10), (0.78, 0.87), (0.13, 0.80))

#: Seen from the front.
FRONTAL = ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9))


def flat(board, pixels_per_mm=8.0, margin=0.01):
    """The board seen from the front, with a white margin [m]."""
    scale = 1e3 * pixels_per_mm
    width, height = ((length + 2.0 * margin) * scale for length in board.size)
    image = np.full((round(height), round(width)), 255, np.uint8)
    rectangles = (black_rectangles(board) + np.array([margin, margin, 0, 0])) * scale
    rectangles[:, 2:] += rectangles[:, :2]
    # Edges that neighbours share are rounded alike, or white lines would lie between them.
    for left, top, right, bottom in np.floor(rectangles + 0.5 + 1e-6).astype(int):
        image[top:bottom, left:right] = 0
    return image


def photo(board, quad=TILTED, size=(1280, 960), *, angle=0, noise=4.0, seed=0):
    """The board in perspective on a grey table, and the homography from board [m] to picture [px].

    ``angle`` turns the picture by so many quarters.
    """
    pixels_per_mm, margin = 5.0, 0.01
    source = flat(board, pixels_per_mm, margin)
    width, height = board.size
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    places = np.roll(np.array(quad, np.float32) * size, angle, axis=0)
    H_image_board = cv2.getPerspectiveTransform(corners, np.float32(places))
    # Pixel (0, 0) of the drawing is the square from 0 to 1: its centre lies half a pixel inside.
    scale = 1e3 * pixels_per_mm
    H_board_source = np.array(
        [[1 / scale, 0, 0.5 / scale - margin], [0, 1 / scale, 0.5 / scale - margin], [0, 0, 1]]
    )
    oversampling = 2
    enlarge = np.diag([oversampling, oversampling, 1.0])
    enlarge[:2, 2] = (oversampling - 1) / 2
    large = cv2.warpPerspective(
        source,
        enlarge @ H_image_board @ H_board_source,
        (size[0] * oversampling, size[1] * oversampling),
        flags=cv2.INTER_AREA,
        borderValue=110,
    )
    image = cv2.resize(large, size, interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.7).astype(float) * 0.8 + 20.0
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8), H_image_board
