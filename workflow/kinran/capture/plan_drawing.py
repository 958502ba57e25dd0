"""The drawing of a plan: the hemisphere of its directions from above, and the way of the light arm through them."""

from kinran.base.drawing.canvas import INK, Canvas
from kinran.base.drawing.hemisphere import MARGIN, SIDE, at, draw_hemisphere
from kinran.base.drawing.plots import colour
from kinran.data.capture_plan import Plan, Shot

LEGEND = 150
"""Pixels of the list of groups at the right."""
LINE = 18
"""Pixels from line to line of the list of groups."""


def draw_plan(plan: Plan) -> Canvas:
    """Return a drawing in which the distance from the middle is θ, and φ turns from +u (right) to +v (up).

    Each group of lights has a colour, a line along its way and a ring where it begins; the way to the next group is
    dashed. Directions of the camera are crosses.
    """
    groups = [group for group in plan.groups if group.lights]
    rows = len(groups) + 3
    canvas = Canvas(SIDE + LEGEND, max(SIDE, MARGIN + LINE * rows))
    draw_hemisphere(canvas)
    for index, (group, after) in enumerate(zip(groups, [*groups[1:], None], strict=True)):
        shade = colour(index)
        points = [at(shot.theta, shot.phi) for shot in group.shots]
        canvas.line(points, shade, 1.2, series=group.name)
        if after is not None:
            canvas.line([points[-1], at(after.shots[0].theta, after.shots[0].phi)], INK, 1, dashed=True)
        for number, (shot, point) in enumerate(zip(group.shots, points, strict=True), 1):
            title = f"group {group.name}, shot {number}: {shot.shot}, {_angles(shot.theta, shot.phi)}"
            canvas.dot(point, shade, 2.5 if shot.kind == "light" else 4, title, series=group.name)
        canvas.dot(points[0], shade, 7, f"group {group.name} begins", ring=True, series=group.name)
    for shot in (shot for group in plan.groups for shot in group.shots if shot.camera):
        _cross(canvas, shot)
    _legend(canvas, plan, SIDE)
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
    x, y = at(theta, phi)
    for dx in (-4, 4):
        canvas.line([(x - dx, y - 4), (x + dx, y + 4)], INK, 1.5)


def _angles(theta: float, phi: float) -> str:
    return f"θ {theta:g}°, φ {phi:g}°"
