"""A strict reader of layers in the Common Layer Interface, for no program is there to judge them.

Written from the Common Layer Interface (CLI), version 2.0, ASCII: a header, then layers with the
height of their upper side, and polylines: identifier, direction (0 clockwise, a hole; 1
counter-clockwise, outer), number of points, points. Closed polylines end where they begin.
"""

import re

import numpy as np

ONCE = ("UNITS", "VERSION", "LAYERS", "DATE", "DIMENSION")


def read(path):
    """Return layers as ``(z, area of what is inside)``, in the file's unit times ``units``."""
    text = path.read_bytes().decode("ascii")
    text = re.sub(r"//.*?//", "", text, flags=re.DOTALL)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    assert lines[0] == "$$HEADERSTART"
    end = lines.index("$$HEADEREND")
    header = dict(told(line) for line in lines[1:end])
    assert header.get("ASCII") == "" or "ASCII" in header
    assert set(header) <= {*ONCE, "ASCII", "LABEL", "USERDATA"}, set(header)
    assert {"UNITS", "VERSION"} <= set(header)
    units = float(header["UNITS"])
    assert units > 0
    assert header["VERSION"].isdigit()
    assert lines[end + 1] == "$$GEOMETRYSTART"
    assert lines[-1] == "$$GEOMETRYEND"
    layers = []
    for line in lines[end + 2 : -1]:
        name, value = told(line)
        if name == "LAYER":
            z = float(value)
            assert not layers or z > layers[-1]["z"]
            layers.append({"z": z, "polylines": []})
        else:
            assert name == "POLYLINE", line
            layers[-1]["polylines"].append(polyline(value))
    if "LAYERS" in header:
        assert int(header["LAYERS"]) == len(layers)
    if "DIMENSION" in header:
        check_dimension(header["DIMENSION"], layers)
    return {
        "units": units,
        "header": header,
        "layers": [
            (layer["z"] * units, sum(area for _, area in layer["polylines"]) * units**2)
            for layer in layers
        ],
        "polylines": [[points for points, _ in layer["polylines"]] for layer in layers],
    }


def told(line):
    found = re.fullmatch(r"\$\$([A-Z]+)(?:/(.*))?", line)
    assert found, line
    return found[1], found[2] or ""


def polyline(value):
    number, direction, count, *places = value.split(",")
    assert int(number) >= 0
    points = np.array(places, dtype=float).reshape(-1, 2)
    assert len(points) == int(count) >= 4
    assert (points[0] == points[-1]).all(), "an open polyline"
    x, y = points.T
    area = 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
    assert direction in ("0", "1")
    assert area > 0 if direction == "1" else area < 0, (direction, area)
    return points, area


def check_dimension(value, layers):
    x0, y0, z0, x1, y1, z1 = map(float, value.split(","))
    points = [points for layer in layers for points, _ in layer["polylines"]]
    every = np.concatenate(points) if points else np.array([[x0, y0]])
    assert (every.min(axis=0) >= [x0, y0]).all()
    assert (every.max(axis=0) <= [x1, y1]).all()
    assert z0 <= min((layer["z"] for layer in layers), default=z0)
    assert max((layer["z"] for layer in layers), default=z1) <= z1
