"""The drawing of a plan: the hemisphere of its directions from above, and the way of the light arm through them."""

import math

from kinran.base.drawing.canvas import FAINT, GRID, INK, Canvas, Point
from kinran.base.drawing.plots import colour
from kinran.data.capture_plan import Plan, Shot

RADIUS, MARGIN, LEGEND = 300, 64, 150
"""Pixels of the horizon's radius, around it, and of the list of groups at the right."""
LINE = 18
"""Pixels from line to line of the list of groups."""


def draw_plan(plan: Plan) -> Canvas:
    """Return a drawing in which the distance from the middle is θ, and φ turns from +u (right) to +v (up).

    Each group of lights has a colour, a line along its way and a ring where it begins; the way to the next group is
    dashed. Directions of the camera are crosses.
    """
    groups = [group for group in plan.groups if group.lights]
    rows = len(groups) + 3
    side = 2 * (RADIUS + MARGIN)
    canvas = Canvas(side + LEGEND, max(side, MARGIN + LINE * rows))
    for theta in (30, 60, 90):
        circle = [_at(theta, phi) for phi in range(0, 361, 3)]
        canvas.line(circle, FAINT if theta == 90 else GRID)
        canvas.text((_at(theta, 0)[0] - 3, _at(theta, 0)[1] - 4), f"{theta}°", "end", FAINT, 11)
    for phi, text, anchor in ((0, "0°", "start"), (90, "90°", "middle"), (180, "180°", "end"), (270, "270°", "middle")):
        canvas.line([_at(0, 0), _at(90, phi)], GRID)
        x, y = _at(93, phi)
        canvas.text((x, y + (12 if phi == 270 else 4 if phi != 90 else 0)), f"φ {text}", anchor, FAINT, 11)
    for index, (group, after) in enumerate(zip(groups, [*groups[1:], None], strict=True)):
        shade = colour(index)
        points = [_at(shot.theta, shot.phi) for shot in group.shots]
        canvas.line(points, shade, 1.2, series=group.name)
        if after is not None:
            canvas.line([points[-1], _at(after.shots[0].theta, after.shots[0].phi)], INK, 1, dashed=True)
        for number, (shot, point) in enumerate(zip(group.shots, points, strict=True), 1):
            title = f"group {group.name}, shot {number}: {shot.shot}, {_angles(shot.theta, shot.phi)}"
            canvas.dot(point, shade, 2.5 if shot.kind == "light" else 4, title, series=group.name)
        canvas.dot(points[0], shade, 7, f"group {group.name} begins", ring=True, series=group.name)
    for shot in (shot for group in plan.groups for shot in group.shots if shot.camera):
        _cross(canvas, shot)
    _legend(canvas, plan, side)
    return canvas


def _legend(canvas: Canvas, plan: Plan, left: int) -> None:
    canvas.text((left, MARGIN), plan.fabric, size=13)
    y = MARGIN + LINE
    for index, group in enumerate(group for group in plan.groups if group.lights):
        y += LINE
        canvas.dot((left + 5, y - 4), colour(index), 5, "", series=group.name)
        canvas.text((left + 16, y), f"{group.name}: {len(group.lights)} directions", series=group.name)
    if any(shot.camera for group in plan.groups for shot in group.shots):
        canvas.text((left, y + LINE), "× camera", colour=INK)


def _cross(canvas: Canvas, shot: Shot) -> None:
    theta, phi = shot.camera or (0.0, 0.0)
    x, y = _at(theta, phi)
    for dx in (-4, 4):
        canvas.line([(x - dx, y - 4), (x + dx, y + 4)], INK, 1.5)


def _at(theta: float, phi: float) -> Point:
    """Return the pixel of a direction in degrees; θ is the distance from the middle."""
    reach, turn = RADIUS * theta / 90, math.radians(phi)
    return MARGIN + RADIUS + reach * math.cos(turn), MARGIN + RADIUS - reach * math.sin(turn)


def _angles(theta: float, phi: float) -> str:
    return f"θ {theta:g}°, φ {phi:g}°"
