"""One problem, every code: heat through a Menger sponge of level 2, exported once for each.

u = 1 on XMIN, 0 on XMAX, no flux elsewhere, conductivity 1: the energy ∫|∇u|² is the heat that
flows. Linear tetrahedra give every finite element code the same matrix, so the digits must agree.
OpenFOAM balances over cells instead: ``test_flow.py`` holds its extrapolated flux through hexahedra
of the same sponge to that of finite elements on the same meshes.
"""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import skfem
from programs import said
from skfem.helpers import dot, grad

import porous as po
from porous.guests import ccx
from porous.values import Held, Job, Material, Step

pytestmark = pytest.mark.slow

GETDP = """
Group {
  Solid = Region[{SOLID}]; Hot = Region[{XMIN_FACES}]; Cold = Region[{XMAX_FACES}];
}
Function { one[] = 1; }
Constraint {
  { Name Held; Case { { Region Hot; Value 1; } { Region Cold; Value 0; } } }
}
FunctionSpace {
  { Name H; Type Form0;
    BasisFunction {
      { Name n; NameOfCoef u; Function BF_Node; Support Solid; Entity NodesOf[All]; } }
    Constraint { { NameOfCoef u; EntityType NodesOf; NameOfConstraint Held; } } }
}
Jacobian { { Name Vol; Case { { Region All; Jacobian Vol; } } } }
Integration {
  { Name I; Case { { Type Gauss; Case { { GeoElement Tetrahedron; NumberOfPoints 4; } } } } }
}
Formulation {
  { Name Heat; Type FemEquation;
    Quantity { { Name u; Type Local; NameOfSpace H; } }
    Equation {
      Galerkin { [ Dof{d u}, {d u} ]; In Solid; Jacobian Vol; Integration I; }
    } }
}
Resolution {
  { Name R; System { { Name S; NameOfFormulation Heat; } }
    Operation { Generate[S]; Solve[S]; SaveSolution[S]; } }
}
PostProcessing {
  { Name P; NameOfFormulation Heat;
    Quantity { { Name e; Value {
      Integral { [ {d u} * {d u} ]; In Solid; Jacobian Vol; Integration I; } } } } }
}
PostOperation {
  { Name E; NameOfPostProcessing P;
    Operation { Print[ e[Solid], OnGlobal, Format Table, File "energy.txt" ]; } }
}
"""

FREEFEM = """
load "gmsh"
mesh3 Th = gmshload3("sponge.msh");
fespace Vh(Th, P1);
Vh u, v;
solve heat(u, v, solver = CG, eps = 1e-14)
  = int3d(Th)(dx(u)*dx(v) + dy(u)*dy(v) + dz(u)*dz(v)) + on({hot}, u = 1) + on({cold}, u = 0);
cout.precision(12);
cout << "ENERGY " << int3d(Th)(dx(u)^2 + dy(u)^2 + dz(u)^2) << endl;
cout << "VOLUME " << int3d(Th)(1.) << endl;
"""


@pytest.fixture(scope="module")
def sponge():
    """The mesh that everybody gets, and its energy by scikit-fem."""
    surface = po.exact_surface(po.build(po.load("menger", set={"model.level": 2})))
    mesh = po.name_parts(po.tetrahedralize(surface), po.Box((0, 0, 0), (1, 1, 1)))
    return SimpleNamespace(mesh=mesh, energy=energy(mesh))


def energy(mesh):
    """Return the energy by scikit-fem, in the mesh's own points and node sets."""
    m = skfem.MeshTet(np.ascontiguousarray(mesh.points.T), mesh.blocks[0].cells.T.copy())
    basis = skfem.Basis(m, skfem.ElementTetP1())
    A = skfem.BilinearForm(lambda u, v, _: dot(grad(u), grad(v))).assemble(basis)
    hot, cold = (mesh.parts[name].members for name in ("XMIN", "XMAX"))
    u = np.zeros(len(mesh.points))
    u[hot] = 1
    u = skfem.solve(*skfem.condense(A, x=u, D=np.concatenate([hot, cold])))
    return float(u @ A @ u)


def run(folder, *command, **environment):
    return said(command, folder, seconds=120, environment=environment)[0]


def test_getdp(sponge, judge, tmp_path):
    po.write(sponge.mesh, tmp_path / "sponge.msh2")
    (tmp_path / "sponge.msh2").rename(tmp_path / "sponge.msh")
    (tmp_path / "heat.pro").write_text(numbered(GETDP, tmp_path / "sponge.msh"))
    run(tmp_path, judge("getdp"), "heat.pro", "-msh", "sponge.msh", "-solve", "R", "-pos", "E")
    found = float((tmp_path / "energy.txt").read_text().split()[-1])
    assert found == pytest.approx(sponge.energy, rel=1e-8)


def test_freefem(sponge, judge, tmp_path):
    program = judge("FreeFem++")
    po.write(sponge.mesh, tmp_path / "sponge.msh2")
    (tmp_path / "sponge.msh2").rename(tmp_path / "sponge.msh")
    (tmp_path / "heat.edp").write_text(labelled(FREEFEM, tmp_path / "sponge.msh"))
    printed = run(
        tmp_path, program, "-nw", "-ng", "heat.edp", FF_LOADPATH="/usr/lib/freefem++", DISPLAY=""
    )
    found = dict(re.findall(r"^(ENERGY|VOLUME) (\S+)", printed, re.MULTILINE))
    assert float(found["ENERGY"]) == pytest.approx(sponge.energy, rel=1e-6)
    assert float(found["VOLUME"]) == pytest.approx(sponge.mesh.volumes.sum(), rel=1e-9)


def test_calculix(sponge, judge):
    from porous.formats.inp import write

    judge("ccx")
    unit = Material("unit", conductivity=1.0)
    held = (Held("XMIN", "temperature", 1.0), Held("XMAX", "temperature", 0.0))
    job = Job("heat", sponge.mesh, {"SOLID": unit}, (Step("heat", "conduction", held),))
    solved = ccx.solve(write(job), time_limit=120)
    flows = [values[0] for (what, _), values in solved.steps[0].items() if what == ccx.HEAT]
    assert len(flows) == 2
    assert abs(sum(flows)) < 1e-5 * sponge.energy
    for flow in flows:
        assert abs(flow) == pytest.approx(sponge.energy, rel=1e-5)


def names(path):
    """Return the numbers of the physical names of a Gmsh file."""
    text = path.read_text()
    block = text[text.index("$PhysicalNames") : text.index("$EndPhysicalNames")]
    return {name: number for number, name in re.findall(r'^\d (\d+) "(.*)"', block, re.MULTILINE)}


def numbered(text, path):
    for name, number in names(path).items():
        text = text.replace(f"{{{name}}}", number)
    return text


def labelled(text, path):
    found = names(path)
    return text.replace("{hot}", found["XMIN_FACES"]).replace("{cold}", found["XMAX_FACES"])
