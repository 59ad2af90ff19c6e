"""What does a support tree bear, and what heat does it lead, beside a bar, a post and a lattice?

Every body bears the same plate, has the same volume and stands on the lower side of its box. Voxels
become hexahedra; CalculiX runs the deck as it is written, and scikit-fem finds the heat that flows
through the same elements. Stiffness is the force over the mean deflection of the face that bears
the pressure, F²/2U; conductance is the heat per degree between the lower side and that face. Over
Young's modulus and over conductivity both are lengths and no property of the material but
Poisson's ratio; of a bar of section A and height H they are A/H. Each is found at two resolutions:
what stands in the table is the finer one, ``_change`` is how far it is from the coarser one.
"""

import csv
import itertools
import math
import os
from pathlib import Path

import numpy as np
import skfem
from scipy.sparse import diags
from scipy.sparse.linalg import cg
from skfem.helpers import dot, grad

import porous as po
from porous.formats import inp
from porous.guests import ccx
from porous.jobs import compression, material
from porous.models.automaton import Automaton, State, Transition
from porous.models.cifs import cifs
from porous.models.drawing import nothing, sticks
from porous.models.tree import tree

RESULTS = Path(os.environ.get("POROUS_RESULTS", Path(__file__).parent / "results"))
EDGE, PLATE = 24.0, 1.2
"""Of the face and of the height under it, and the plate's thickness, in mm."""
DOMAIN = po.Box((0.0, 0.0, 0.0), (EDGE, EDGE, EDGE + PLATE / 2))
SOLID = 0.15
"""The part of the box that each porous body fills, plate and all."""
SMALL = bool(os.environ.get("POROUS_SMALL"))
VOXELS, BAR_VOXELS = ((21, 31), (4, 6)) if SMALL else ((41, 61), (12, 18))
"""Along the edge, coarse and fine: no multiples of a lattice's cells, whose beams would all gain
or lose the same voxels. A bar has no detail."""
METAL = material("ti-6al-4v")
CUBE = np.array(list(itertools.product((0, 1), repeat=3)))
TOP = [[0, 0, EDGE], [0, EDGE, EDGE], [EDGE, 0, EDGE], [EDGE, EDGE, EDGE]]
FACE, ROOT = [1, 3, 7, 5], [EDGE / 2, EDGE / 2, 0]
QUANTITIES = ("stiffness_per_mass", "conductance_per_mass", "stiffness_to_conduction")
"""Beside the bar's, which are 1."""


def branched(branches, law, level=2):
    """Return the tree of a radius, and the plate that it bears."""
    return lambda radius: tree(
        branches,
        (0.35, 0.45),
        radius=radius,
        level=level,
        law=law,
        plate=PLATE,
        controls=[*TOP, ROOT],
        domain=DOMAIN,
        bulk=DOMAIN,
    )


def lattice(cells):
    """Return the lattice of cubes with beams along their edges, and the plate that it bears."""
    states = (
        State("block", EDGE * CUBE.T),
        State("cube", CUBE.T),
        State("plate", CUBE[FACE].T),
    )
    places = itertools.product(range(cells), repeat=3)
    cubes = [Transition(0, 1, weights((place + CUBE) / cells)) for place in places]
    automaton = Automaton(states, (*cubes, Transition(0, 2, np.eye(8)[:, FACE])))
    plate = sticks(4, plates=[range(4)], thickness=PLATE)
    return lambda radius: cifs(
        automaton,
        [nothing(8), sticks(8, beams="edges", radius=radius), plate],
        level=1,
        domain=DOMAIN,
        bulk=DOMAIN,
    )


def weights(places):
    """Return the trilinear weights (8, n) of places (n, 3) in the cube."""
    return np.where(CUBE[:, None], places, 1 - places).prod(axis=2)


BODIES = {
    "post": branched((2,), "area", level=0),
    "cubic lattice": lattice(4),
    "tree 2, 2, area": branched((2,), "area"),
    "tree 2, 2, murray": branched((2,), "murray"),
    "tree 3, 2, area": branched((3, 2), "area"),
    "tree 3, 2, murray": branched((3, 2), "murray"),
}


def sampled(body, voxels):
    """Return the body's voxels, its radius such that it fills ``SOLID`` of its box."""
    radius, plate = 1.0, PLATE / DOMAIN.lengths[2]
    for _ in range(8):
        grid = po.voxelize(body(radius), spacing=(EDGE / voxels,) * 3)
        share = grid.fill.mean() / 255
        if abs(share - SOLID) < 1e-4 * SOLID:
            break
        radius *= math.sqrt((SOLID - plate) / (share - plate))
    return radius, grid


def bar(voxels):
    """Return a bar of the whole box."""
    frame = po.Frame.fit(DOMAIN, voxels=voxels)
    return po.VoxelGrid.of_solid(np.ones(frame.shape, bool), frame)


def conductance(mesh):
    """Return the heat per degree from the lower side to the upper one, over conductivity, in mm."""
    order = [0, 1, 3, 4, 2, 5, 7, 6]  # scikit-fem's corners in VTK's numbers
    points, cells = mesh.points.T, mesh.blocks[0].cells[:, order].T
    elements = skfem.MeshHex(np.ascontiguousarray(points), np.ascontiguousarray(cells))

    @skfem.BilinearForm
    def conduction(u, v, _):
        return dot(grad(u), grad(v))

    matrix = conduction.assemble(skfem.Basis(elements, skfem.ElementHex1(), intorder=3))
    hot, cold = (mesh.parts[side].members for side in ("ZMIN", "ZMAX"))
    heat = np.zeros(len(mesh.points))
    heat[hot] = 1.0
    inner = np.setdiff1d(np.arange(len(heat)), [*hot, *cold])
    part = matrix[inner][:, inner]
    heat[inner], failed = cg(
        part, -(matrix @ heat)[inner], rtol=1e-10, M=diags(1 / part.diagonal())
    )
    assert not failed
    return float(heat @ (matrix @ heat))


def solved(grid):
    """Return stiffness and conductance in mm, volume in mm³ and elements of a grid's solid."""
    mesh = po.name_parts(po.hexahedralize(grid), grid.frame.box)
    job = compression(mesh, material=METAL, pressure=1.0)
    found = ccx.solve(inp.write(job))
    stiffness = found.reaction[2] ** 2 / (2 * found.energy) / METAL.youngs_modulus
    return stiffness, conductance(job.mesh), found.volume, job.mesh.cells


def compared(found, beside):
    """Return stiffness and conductance per mass and their ratio, beside the bar's."""
    stiffness, conduction, volume = np.divide(found[:3], beside[:3])
    return np.array([stiffness / volume, conduction / volume, stiffness / conduction])


def rows():
    bars = [solved(bar(voxels)) for voxels in BAR_VOXELS]
    yield row("bar", "", bars, bars)
    for name, body in BODIES.items():
        radius, fine = sampled(body, VOXELS[1])
        coarse = po.voxelize(body(radius), spacing=(EDGE / VOXELS[0],) * 3)
        yield row(name, f"{radius:.3f}", [solved(coarse), solved(fine)], bars)


def row(name, radius, found, bars):
    """Return a row of the table: the finer of both, and its changes from the coarser one."""
    ratios = [compared(one, beside) for one, beside in zip(found, bars, strict=True)]
    figures = {
        "porosity": [1 - one[2] / DOMAIN.volume for one in found],
        "stiffness_mm": [one[0] for one in found],
        "conductance_mm": [one[1] for one in found],
        **{name: [ratio[k] for ratio in ratios] for k, name in enumerate(QUANTITIES)},
    }
    result = {"body": name, "radius_mm": radius, "elements": found[1][3]}
    for quantity, (coarse, fine) in figures.items():
        result |= {quantity: f"{fine:.5f}", f"{quantity}_change": f"{fine - coarse:.5f}"}
    print(*result.values(), sep="  ", flush=True)
    return result


COLOURS = ("#35658f", "#c8553d", "#8a8f98")
LEFT, UNIT, BAND, LINE = 170, 460, 54, 15
"""Pixels: left of the bars, of a ratio of 1, of a body, of a bar."""


def figure(table):
    """Yield the lines of a picture of the three quantities of every body, as SVG."""
    wide, high = LEFT + UNIT + 100, BAND * len(table) + 70
    yield f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}"'
    yield ' font-family="sans-serif" font-size="12" fill="#222">'
    yield f'<rect width="{wide}" height="{high}" fill="#fff"/>'
    for k, (name, colour) in enumerate(zip(QUANTITIES, COLOURS, strict=True)):
        yield f'<rect x="{LEFT + 180 * k}" y="12" width="12" height="12" fill="{colour}"/>'
        yield f'<text x="{LEFT + 180 * k + 17}" y="22">{name.replace("_", " ")}</text>'
    for i, line in enumerate(table):
        top = 42 + BAND * i
        yield f'<text x="{LEFT - 8}" y="{top + 27}" text-anchor="end">{line["body"]}</text>'
        for k, (name, colour) in enumerate(zip(QUANTITIES, COLOURS, strict=True)):
            value, change = float(line[name]), abs(float(line[f"{name}_change"]))
            y, end = top + LINE * k, LEFT + UNIT * value
            yield f'<rect x="{LEFT}" y="{y}" width="{end - LEFT:.1f}" height="13" fill="{colour}"/>'
            yield f'<text x="{end + 5:.1f}" y="{y + 11}">{value:.3f} ± {change:.3f}</text>'
    note = "beside a solid bar, which is 1; ± is the change from the coarser voxels"
    yield f'<text x="{LEFT}" y="{high - 12}">{note}</text>'
    yield "</svg>"


def main():
    table = list(rows())
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / "10_support_tree.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, table[0])
        writer.writeheader()
        writer.writerows(table)
    picture = "\n".join(figure(table)) + "\n"
    (RESULTS / "10_support_tree.svg").write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
