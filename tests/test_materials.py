"""Materials: figures with their units, of the presets and of files of the user's own."""

import numpy as np
import pytest

from porous import hexahedralize, load, name_parts
from porous.errors import MeshError, RecipeError
from porous.jobs import material, prepare, sections
from porous.jobs._material import UNITS, check_known, read_material
from porous.presets import material_names
from porous.values import Frame, Material, VoxelGrid
from porous.values.job import PROPERTIES


@pytest.mark.parametrize("name", material_names())
def test_materials_of_the_presets(name):
    found = material(name)
    assert found.name == name
    assert found.source
    # What is known lies where matter is: figures in wrong units do not.
    ranges = {
        "youngs_modulus": (1e2, 1.3e6),
        "density": (1e-12, 2.3e-8),
        "conductivity": (1e-2, 3e3),
        "specific_heat": (1e8, 1.5e10),
        "viscosity": (5e-12, 1e-3),
        "diffusivity": (1e-5, 100),
    }
    for key, (low, high) in ranges.items():
        value = getattr(found, key)
        assert value is None or low < value < high, key


def test_the_figures_that_everybody_knows():
    steel, water, air = material("steel"), material("water"), material("air")
    assert (steel.youngs_modulus, steel.poissons_ratio) == (210e3, 0.3)
    assert steel.density == pytest.approx(7.85e-9)
    assert water.viscosity == pytest.approx(1e-9, rel=2e-3)
    assert water.youngs_modulus is None
    # Of a gas, Pr = μ·c/λ is about 0.71; in mm, t, s as in m, kg, s.
    assert air.viscosity * air.specific_heat / air.conductivity == pytest.approx(0.707, abs=1e-3)
    with pytest.raises(RecipeError, match="steel"):
        material("stele")
    with pytest.raises(MeshError, match="water: has no youngs_modulus; it has density"):
        water.known("youngs_modulus")


def test_every_dimension_has_units():
    assert set(UNITS) == set(PROPERTIES.values()) - {"number"}


FRAME = Frame((0, 0, 0), (1, 1, 1), (2, 2, 2))
NUMBERS = ("youngs_modulus", "poissons_ratio", "density")
GOOD = {
    "title": '"Rubber"',
    "source": '"none"',
    "youngs_modulus": '"1000 psi"',
    "poissons_ratio": "0.49",
    "density": '"1.1 g/cm3"',
}


def written(tmp_path, **changes):
    lines = (GOOD | changes).items()
    path = tmp_path / "rubber.toml"
    path.write_text("\n".join(f"{key} = {value}" for key, value in lines if value is not None))
    return path


def test_units_are_read(tmp_path):
    more = {
        "conductivity": '"1.5 W/(cm K)"',
        "specific_heat": '"2 kJ/(kg K)"',
        "viscosity": '"2e3 Pa s"',
        "diffusivity": '"3 cm2/s"',
    }
    rubber = read_material(written(tmp_path, **more))
    wanted = Material("rubber", 6.894757293168, 0.49, 1.1e-9, "none", 150.0, 2e9, 2e-3, 300.0)
    for key in PROPERTIES:
        assert getattr(rubber, key) == pytest.approx(getattr(wanted, key), rel=1e-12), key
    assert rubber.name == "rubber"


@pytest.mark.parametrize(
    ("key", "text", "wanted"),
    [
        ("conductivity", "53.3 W/(m·K)", 53.3),
        ("conductivity", "53.3 W/(m⋅K)", 53.3),
        ("conductivity", "53.3 mW/(mm·K)", 53.3),
        ("specific_heat", "440 J/(kg·K)", 4.4e8),
        ("specific_heat", "440 J/(kg*K)", 4.4e8),
        ("youngs_modulus", "3 N/mm2", 3.0),
        ("youngs_modulus", "3 N/mm²", 3.0),
        ("youngs_modulus", "3 kN/mm^2", 3e3),
        ("youngs_modulus", "3 N/m²", 3e-6),
        ("density", "7850 kg/m³", 7.85e-9),
        ("density", "7850 kg/m^3", 7.85e-9),
        ("viscosity", "1 mPa·s", 1e-9),
        ("diffusivity", "2e-9 m²/s", 2e-3),
    ],
)
def test_signs_of_products_and_powers_are_read(tmp_path, key, text, wanted):
    made = read_material(written(tmp_path, **{key: f'"{text}"'}))
    assert getattr(made, key) == pytest.approx(wanted, rel=1e-12)


def test_materials_that_are_not_there_are_told_in_sentences():
    with pytest.raises(RecipeError, match=r"no material 'zzz'; there is .*, water\. A file"):
        load("menger", set={"simulation.material": "zzz"})
    with pytest.raises(RecipeError, match=r"did you mean 'steel'\? A file of your own ends in"):
        load("menger", set={"simulation.material": "stele"})
    with pytest.raises(RecipeError, match=r'not found: "gone\.toml"; wanted a file'):
        load("menger", set={"simulation.material": "gone.toml"})


def test_what_a_material_lacks_others_have():
    steel, water = material("steel"), material("water")
    check_known(water, ("flow",))
    with pytest.raises(
        MeshError, match=r"steel: has no viscosity; it has .*; wanted one of"
    ) as told:
        check_known(steel, ("flow",))
    others = str(told.value).partition("wanted one of ")[2]
    assert others == "air, water, or a file of your own"
    pores = name_parts(
        hexahedralize(VoxelGrid.of_solid(np.zeros((2, 2, 2), bool), FRAME), phase="pore"), FRAME.box
    )
    with pytest.raises(MeshError, match="wanted one of air, water"):
        prepare(pores, sections()["flow"](analysis="flow", material="steel"))
    check_known(water, ("static", "conduction"))  # it does for one of them
    with pytest.raises(MeshError, match=r"has no youngs_modulus.*wanted one of .*pla.*steel"):
        check_known(water, ("static",))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"youngs_modulus": '"3.5 gigapascal"'}, "youngs_modulus: got '3.5 gigapascal'.*GPa"),
        ({"youngs_modulus": "3.5"}, "youngs_modulus"),
        ({"youngs_modulus": '"stiff GPa"'}, "youngs_modulus"),
        ({"youngs_modulus": '"-1 GPa"'}, "youngs_modulus = '-1 GPa'; wanted more than zero"),
        ({"youngs_modulus": '"nan GPa"'}, "youngs_modulus = .*more than zero"),
        ({"density": '"7850"'}, "density.*kg/m3"),
        ({"poissons_ratio": "0.5"}, "between −1 and 0.5"),
        ({"poissons_ratio": "true"}, "poissons_ratio"),
        ({"poissons_ratio": '"0.3"'}, "poissons_ratio"),
        ({"yield": "3"}, "yield: unknown key"),
        ({"densty": '"1 kg/m3"'}, "densty: unknown key; did you mean 'density'"),
        ({"source": None}, "lacks source"),
        (dict.fromkeys(NUMBERS), "lacks some of youngs_modulus"),
        ({"conductivity": '"50 W/(m F)"'}, r"conductivity.*W/\(m K\)"),
        ({"specific_heat": '"440 J"'}, r"specific_heat.*J/\(kg K\)"),
        ({"viscosity": '"1 Pa"'}, "viscosity.*mPa s"),
        ({"diffusivity": '"0 m2/s"'}, "diffusivity = '0 m2/s'.*more than zero"),
        ({"density": "[1"}, "cannot be read"),
    ],
)
def test_materials_that_cannot_be_understood(tmp_path, changes, words):
    with pytest.raises(RecipeError, match=words) as caught:
        read_material(written(tmp_path, **changes))
    assert "rubber.toml" in str(caught.value)
