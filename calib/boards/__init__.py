"""Printed boards (ChArUco boards, chessboards, grids of AprilTags): describe, draw, print, find and render them.

Describe    `board.Board`; `board_file.read_board` and `board_file.board_toml` read and write descriptions
Design      `board_design.design` chooses what is open, so that the board is as large as fits on a paper
Draw        `board_page.page_of` makes a page to print, `board_page.WRITERS` write it as PDF and SVG
Measure     `printed.print_scale` reads what a print measures, `printed.rescaled` gives the board as printed
Find        `detection.detect.detect` finds corners in pictures, with standard deviations, and wrong descriptions
Render      `printed.draw_print` draws a print with its errors, `render.render` a picture of it by a camera, and
            `project.corner_pixels` the pixels of its corners; a camera is any object with the attributes of
            `project.Camera`

This room stands apart: of calib it imports the errors and the basics only, and OpenCV is used nowhere else. Lengths are
in metres, angles in radians. The centre of the first pixel of an image is at (0, 0).
"""
