"""The exact boundary of a polyhedral prefractal: booleans of the maps' images, level by level.

Booleans of floating-point meshes are only as good as the coincidence of their coordinates: faces
that ought to lie on each other must carry the *same* numbers. So the pieces' coordinates are
gathered into classes before each union, in axes along which a box-like primitive's faces are flat.
What cannot be made certain is refused: the union is computed twice, in another order and with
coarser classes, and every triangle of it is held against the cells themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from porous.errors import MeshError, ModelError
from porous.guests.manifold import Body, ball, box, intersection, union
from porous.memory import check_memory
from porous.models.apart import apart
from porous.models.automaton import cells, count_cells, frames
from porous.models.contacts import contact_points
from porous.models.membership import candidates, check_invertible, covered
from porous.models.primitive import Primitive
from porous.values import Box, SurfaceMesh
from porous.values.box import SIDES
from porous.values.surface_topology import defects, euler_number, pieces

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from porous.models.automaton import Automaton

    Floats = NDArray[np.float64]

SAME = 1e-12
"""Coordinates closer than this are one, relative to the body's size."""

COARSE = 30 * SAME
"""The classes of the second, independent union."""

APART = 1e-7
"""Points closer than this but not the same make the topology uncertain, relative to the size."""

PROBE = 1e-6
"""How far from a triangle the solid's two sides are asked for, relative to a cell's thickness."""

SEGMENTS = 8
"""Segments around the balls that fuse contacts: 32 triangles each, of the ball's volume. A body
fused by them has the volume of one fused by balls within 5e-5."""

PROBES = 1 << 22
"""How many products of point and plane the check of the triangles may take."""

BYTES = 700
"""Memory that the engine takes per triangle of the pieces."""


def exact_boundary(
    automaton: Automaton,
    primitive: Primitive,
    level: object,
    *,
    offset: float = 0.0,
    contacts: str = "apart",
    contact_radius: float = 0.0,
    domain: Box | None = None,
    unit: str = "mm",
    progress: Callable[[float], None] | None = None,
) -> SurfaceMesh:
    """Return the closed, oriented boundary of the union of a level's cells.

    Where cells touch in a point or an edge only, they stay apart: each body is closed and shares
    no points with another, though some lie at the same place. With ``contacts = "fuse"`` a
    polyhedron of 32 triangles with the volume of a ball of ``contact_radius`` is added at each
    contact.

    Parameters
    ----------
    automaton
        Every state with four independent controls.
    primitive
        The polyhedron that each cell is an image of, in the coordinates of the states.
    level
        A whole number; the boundary of a limit or a cut set is not made of finitely many
        similar pieces.
    offset
        Must be zero: the offset of a polyhedron is not a polyhedron.
    contacts
        ``"apart"`` or ``"fuse"``.
    contact_radius
        Of the balls that fuse, in ``unit``.
    domain
        What is beyond this box is cut off; triangles on its sides are labelled with their names,
        ``XMIN`` … ``ZMAX``, as those of voxels are.
    unit
        Unit of length.
    progress
        Called with the part done, in [0, 1]; raising in it ends the work.

    Raises
    ------
    ModelError
        Where no exact boundary is available, or where its topology would not be certain; the
        message names what to do instead.
    MemoryLimitError
        Where the level has too many cells.
    """
    depth = _available(automaton, primitive, level, offset)
    amount = count_cells(automaton, depth) * len(primitive.triangles)
    check_memory(
        amount * BYTES,
        f"the exact boundary of level {depth} ({amount} triangles)",
        "Choose a lower level, or extract_surface on voxels.",
    )
    tell = progress or (lambda _: None)
    placed_cells = frames(automaton, cells(automaton, depth))
    check_invertible(placed_cells)
    balls = _balls(primitive, placed_cells, contacts, contact_radius)
    surfaces = []
    for turn, (order, same) in enumerate(((1, SAME), (-1, COARSE))):
        tell(0.45 * turn)
        body = _fused(_grown(automaton, primitive, depth, order, same), balls, order)
        surfaces.append(_surface(_cut(body, domain), unit))
    tell(0.9)
    _check_agreement(*surfaces)
    _check_distances(surfaces[0])
    _check_sides(surfaces[0], _Solid(primitive, placed_cells, balls, domain))
    tell(1.0)
    return _labelled(surfaces[0], domain)


def _available(automaton: Automaton, primitive: Primitive, level: object, offset: float) -> int:
    instead = "use extract_surface on voxels"
    if offset:
        raise ModelError(f"exact surface: not available with an offset; {instead}")
    if not isinstance(level, int):
        raise ModelError(f"exact surface: not available for level = {level!r}; {instead}")
    if primitive.radius is not None:
        raise ModelError(f"exact surface: not available for balls; {instead}")
    if not automaton.spatial:
        raise ModelError(f"exact surface: the cells are no affine images of space; {instead}")
    return level


class _Balls(NamedTuple):
    """Equal polyhedra, one about each contact."""

    shape: Primitive | None
    frames: Floats
    """Shape (c, 3, 4)."""


def _balls(primitive: Primitive, cells: Floats, contacts: str, radius: float) -> _Balls:
    if contacts != "fuse":
        return _Balls(None, np.zeros((0, 3, 4)))
    if not radius > 0:
        raise ModelError(f"contacts = 'fuse': got a contact_radius of {radius}; wanted more than 0")
    points, triangles = ball(radius, SEGMENTS)
    centres = contact_points(primitive, cells)
    frames = np.broadcast_to(np.eye(3, 4), (len(centres), 3, 4)).copy()
    frames[:, :, 3] = centres
    # Turned so that no corner or edge of a ball lies in a plane of the cells.
    return _Balls(Primitive("ball", points @ _TURN.T, triangles, convex=True), frames)


def _rotation(x: float, y: float, z: float) -> Floats:
    result = np.eye(3)
    for angle, (i, j) in ((x, (1, 2)), (y, (2, 0)), (z, (0, 1))):
        turn = np.eye(3)
        turn[[i, j, i, j], [i, j, j, i]] = (
            np.cos(angle),
            np.cos(angle),
            -np.sin(angle),
            np.sin(angle),
        )
        result = turn @ result
    return result


_TURN = _rotation(0.7310, 1.1390, 0.2710)


def _fused(body: Body, balls: _Balls, order: int) -> Body:
    if balls.shape is None or not len(balls.frames):
        return body
    shape = balls.shape
    added = [Body(shape.points + frame[:, 3], shape.triangles) for frame in balls.frames]
    return union([body, *added][::order])


def _cut(body: Body, domain: Box | None) -> Body:
    if domain is None or domain.contains(Box.of_points(body.points)):
        return body
    # The box's planes and what lies in them get the same numbers first.
    frame = box(domain.lower, domain.upper)
    points = gathered(np.concatenate([frame.points, body.points]), SAME)
    corners = len(frame.points)
    return intersection(
        Body(points[corners:], body.triangles), Body(points[:corners], frame.triangles)
    )


def _grown(automaton: Automaton, primitive: Primitive, level: int, order: int, same: float) -> Body:
    """Return K of the start state after ``level`` steps K_q ← ∪ T(K_r) over q's transitions."""
    axes = _axes(primitive)
    seed = Body(gathered(primitive.points @ axes.T, same), primitive.triangles)
    bodies = [seed] * len(automaton.states)
    for step in range(level):
        states = {automaton.start} if step == level - 1 else range(len(automaton.states))
        bodies = [
            _united(automaton, bodies, state, axes, order, same)
            if state in states
            else bodies[state]
            for state in range(len(automaton.states))
        ]
    body = bodies[automaton.start]
    return Body(body.points @ np.linalg.inv(axes).T, body.triangles)


def _united(
    automaton: Automaton, bodies: list[Body], state: int, axes: Floats, order: int, same: float
) -> Body:
    moved = [
        _moved(bodies[transition.target], automaton.maps[index], axes)
        for index, transition in enumerate(automaton.transitions)
        if transition.source == state
    ][::order]
    if not moved:
        return bodies[state]
    points = gathered(np.concatenate([body.points for body in moved]), same)
    ends = np.cumsum([len(body.points) for body in moved])[:-1]
    return union([Body(p, b.triangles) for p, b in zip(np.split(points, ends), moved, strict=True)])


def _moved(body: Body, frame: Floats, axes: Floats) -> Body:
    linear = axes @ frame[:, :3] @ np.linalg.inv(axes)
    points = body.points @ linear.T + axes @ frame[:, 3]
    mirrored = np.linalg.det(linear) < 0
    return Body(points, body.triangles[:, ::-1] if mirrored else body.triangles)


def gathered(points: Floats, same: float) -> Floats:
    """Return points whose coordinates are one number where they are closer than ``same``.

    Each axis by itself; ``same`` is relative to the points' size; a class takes its lowest number.
    """
    result = points.copy()
    reach = same * np.abs(points).max(initial=0.0)
    for axis in range(3):
        order = np.argsort(points[:, axis])
        values = points[order, axis]
        opens = np.concatenate([[True], np.diff(values) > reach])
        result[order, axis] = values[opens][np.cumsum(opens) - 1]
    return result


def _axes(primitive: Primitive) -> Floats:
    """Return the normals of a primitive whose faces have three directions, else the world's axes.

    In these axes a turned or sheared box is upright, and coordinates that ought to be equal can
    be made so.
    """
    corners = primitive.points[primitive.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found: list[Floats] = []
    for normal in normals:
        if not any(abs(abs(normal @ other) - 1) < 1e-9 for other in found):
            found.append(normal)
    if len(found) != 3 or _upright(found):
        return np.eye(3)
    axes = np.array(found)
    return np.asarray(axes * np.sign(np.linalg.det(axes)))


def _upright(normals: list[Floats]) -> bool:
    return all(np.abs(normal).max() > 1 - 1e-12 for normal in normals)


def _surface(body: Body, unit: str) -> SurfaceMesh:
    try:
        points, triangles = apart(gathered(body.points, COARSE), body.triangles)
    except MeshError as error:
        raise _refused(str(error)) from None
    return SurfaceMesh(points, triangles, unit=unit)


def _refused(why: str) -> ModelError:
    return ModelError(
        f"exact surface: its topology would not be certain: {why}; use extract_surface on voxels, "
        'or method = "marching-cubes" in [surface]'
    )


def _check_agreement(one: SurfaceMesh, two: SurfaceMesh) -> None:
    for surface in (one, two):
        found = defects(surface)
        if not len(surface.triangles) or found:
            raise _refused(f"the union is not a closed manifold near {found.first}")
    facts = [(euler_number(s), int(pieces(s).max()) + 1) for s in (one, two)]
    if facts[0] != facts[1]:
        (a, b), (c, d) = facts
        raise _refused(
            f"Euler number {a} and {b} pieces turn into {c} and {d} when the maps are taken in "
            "another order and coordinates are rounded a little more coarsely"
        )
    for name in ("volume", "area"):
        values = [getattr(s, name) for s in (one, two)]
        if abs(values[0] - values[1]) > 1e-9 * abs(values[0]):
            raise _refused(f"its {name} depends on the order of the maps: {values}")


def _check_distances(surface: SurfaceMesh) -> None:
    from scipy.spatial import cKDTree

    size = float(np.abs(surface.points).max())
    places = np.unique(gathered(surface.points, COARSE), axis=0)
    pairs = cKDTree(places).query_pairs(APART * size, output_type="ndarray")
    if len(pairs):
        a, b = places[pairs[0]]
        raise _refused(
            f"{len(pairs)} pairs of points nearly coincide, the first {np.linalg.norm(a - b):.2g} "
            f"{surface.unit} apart at {_place(a)}"
        )


class _Solid(NamedTuple):
    """What the body is made of: cells and balls, cut by a domain."""

    primitive: Primitive
    cells: Floats
    balls: _Balls
    domain: Box | None

    def holds(self, points: Floats) -> NDArray[np.bool_]:
        inside = covered(points, self.primitive, self.cells)
        if self.balls.shape is not None and len(self.balls.frames):
            inside |= covered(points, self.balls.shape, self.balls.frames)
        if self.domain is not None:
            inside &= (points >= self.domain.lower).all(axis=1)
            inside &= (points <= self.domain.upper).all(axis=1)
        return inside


def _check_sides(surface: SurfaceMesh, solid: _Solid) -> None:
    """Ask on both sides of the triangles whether solid is inside and void outside."""
    middles = surface.corners.mean(axis=1)
    chosen = _chosen(middles, solid.primitive, solid.cells)
    normals = surface.area_vectors[chosen]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    shrunk = np.linalg.svd(solid.cells[:, :, :3], compute_uv=False).min()
    step = PROBE * shrunk * solid.primitive.thickness
    for side, wanted in ((-step, True), (step, False)):
        wrong = np.flatnonzero(solid.holds(middles[chosen] + side * normals) != wanted)
        if len(wrong):
            raise _refused(
                f"{len(wrong)} of {len(chosen)} triangles do not lie between solid and void, the "
                f"first at {_place(middles[chosen[wrong[0]]])}"
            )


def _chosen(middles: Floats, primitive: Primitive, cells: Floats) -> NDArray[np.int64]:
    """Return the triangles to ask: all, or as many, evenly spread, as ``PROBES`` allows."""
    few = middles[:: max(1, len(middles) // 256)]
    pairs = len(candidates(few, primitive, cells)[0]) / len(few)
    faces = len(primitive.planes if primitive.convex else primitive.triangles)
    count = min(len(middles), int(PROBES / max(1.0, pairs * faces)) + 1)
    return np.linspace(0, len(middles) - 1, count).astype(np.int64)


def _labelled(surface: SurfaceMesh, domain: Box | None) -> SurfaceMesh:
    if domain is None:
        return surface
    labels = np.zeros(len(surface.triangles), dtype=np.int16)
    reach = COARSE * max(map(abs, (*domain.lower, *domain.upper)))
    for index in range(len(SIDES)):
        axis, end = divmod(index, 2)
        level = (domain.lower, domain.upper)[end][axis]
        on = np.abs(surface.points[:, axis] - level) <= reach
        labels[on[surface.triangles].all(axis=1)] = index + 1
    return replace(surface, labels=labels, names=("WALL", *SIDES))


def _place(point: Floats) -> str:
    return "(" + ", ".join(f"{v:.6g}" for v in point) + ")"
