"""manifold3d: booleans of closed meshes that never leave a hole."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from porous.errors import GuestError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


class Body(NamedTuple):
    """A closed mesh: points float64 (n, 3), triangles int64 (t, 3), outward."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


def union(bodies: Sequence[Body]) -> Body:
    """Return the boundary of the union of closed meshes.

    Faces that lie on each other are recognised where their coordinates are the *same* numbers;
    the caller sees to that. Flat faces keep their triangles, so that no slivers appear.

    Raises
    ------
    GuestError
        Where the engine refuses a mesh or its result is not a manifold.
    """
    import manifold3d

    made = [_made(body) for body in bodies]
    joined = manifold3d.Manifold.batch_boolean(made, manifold3d.OpType.Add)
    _check(joined)
    return _body(joined)


def intersection(one: Body, other: Body) -> Body:
    """Return the boundary of what two closed meshes have in common.

    Raises
    ------
    GuestError
        As ``union`` does.
    """
    joined = _made(one) ^ _made(other)
    _check(joined)
    return _body(joined)


def box(lower: Sequence[float], upper: Sequence[float]) -> Body:
    """Return the box between two corners."""
    import manifold3d

    points, triangles = _body(manifold3d.Manifold.cube((1.0, 1.0, 1.0)))
    ends = np.array([lower, upper], dtype=np.float64)
    return Body(ends[points.astype(np.int64), np.arange(3)], triangles)


def ball(radius: float, segments: int) -> Body:
    """Return a geodesic sphere about the origin with ``segments`` around, of a ball's volume."""
    import manifold3d

    points, triangles = _body(manifold3d.Manifold.sphere(1.0, segments))
    # Inscribed at first; it is grown to the volume of the ball it stands for.
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    volume = np.einsum("ij,ij->", np.cross(a, b), c) / 6
    return Body(points * radius * (4 / 3 * np.pi / volume) ** (1 / 3), triangles)


def _made(body: Body) -> Any:
    import manifold3d

    # A face number for each triangle keeps the engine from merging flat neighbours, which leaves
    # triangles without area along straight rows of points.
    mesh = manifold3d.Mesh64(
        np.ascontiguousarray(body.points, dtype=np.float64),
        np.ascontiguousarray(body.triangles, dtype=np.uint64),
        face_id=np.arange(len(body.triangles), dtype=np.uint64),
    )
    made = manifold3d.Manifold(mesh)
    _check(made)
    return made


def _check(made: Any) -> None:
    status = made.status()
    if status.name != "NoError":
        raise GuestError(f"manifold3d refused a mesh: {status.name}")


def _body(made: Any) -> Body:
    mesh = made.to_mesh64()
    points = np.array(mesh.vert_properties[:, :3], dtype=np.float64)
    triangles = np.array(mesh.tri_verts, dtype=np.int64)
    if mesh.merge_from_vert is not None and len(mesh.merge_from_vert):
        name = np.arange(len(points))
        name[mesh.merge_from_vert] = mesh.merge_to_vert
        triangles = name[triangles]
    return Body(points, triangles)
