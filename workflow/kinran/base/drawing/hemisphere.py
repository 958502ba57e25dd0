"""The hemisphere of directions from above: θ is the distance from the middle, φ turns from +u (right) to +v (up)."""

import math

from kinran.base.drawing.canvas import FAINT, GRID, Canvas, Point

RADIUS, MARGIN = 300, 64
"""Pixels of the horizon's radius, and around it."""
SIDE = 2 * (RADIUS + MARGIN)
"""Pixels of the whole drawing's width and height."""


def at(theta: float, phi: float) -> Point:
    """Return the pixel of a direction in degrees."""
    reach, turn = RADIUS * theta / 90, math.radians(phi)
    return MARGIN + RADIUS + reach * math.cos(turn), MARGIN + RADIUS - reach * math.sin(turn)


def draw_hemisphere(canvas: Canvas) -> None:
    """Draw circles at 30, 60 and 90° of θ, and lines at four φ, with their numbers."""
    for theta in (30, 60, 90):
        circle = [at(theta, phi) for phi in range(0, 361, 3)]
        canvas.line(circle, FAINT if theta == 90 else GRID)
        canvas.text((at(theta, 0)[0] - 3, at(theta, 0)[1] - 4), f"{theta}°", "end", FAINT, 11)
    for phi, text, anchor in ((0, "0°", "start"), (90, "90°", "middle"), (180, "180°", "end"), (270, "270°", "middle")):
        canvas.line([at(0, 0), at(90, phi)], GRID)
        x, y = at(93, phi)
        canvas.text((x, y + (12 if phi == 270 else 4 if phi != 90 else 0)), f"φ {text}", anchor, FAINT, 11)
