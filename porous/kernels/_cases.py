"""How a surface of the solid's own topology cuts a cube, for each of the 256 patterns of corners.

Corner c of a cube is (dx, dy, dz) with c = 4 dx + 2 dy + dz; bit c of a case is set where that
corner is solid. Edges: 0–3 run along x at (dy, dz), 4–7 along y at (dx, dz), 8–11 along z at
(dx, dy), each numbered by its two bits. Three digits of ``CASES`` are one triangle of cut edges,
counter-clockwise seen from the void.

The rules, from which a test derives the table anew: on an ambiguous face solid corners stay apart
(solid is 6-connected, void 26-connected); in the four cases where just two opposite corners of the
cube are void, a tunnel joins them; no chord joins two edges that share a face, so neighbours never
have the same one; the triangles of a cube never pass through each other, wherever on their edges
the vertices lie; and among such triangulations the best least angle.
"""

from __future__ import annotations

import numpy as np

CASES = """
- 048 185 041451 294 028298 185294 029095051 359 048359 189193 041491931 235254 028235258
183843423 021231 0a6 4868a6 0a6185 1a4a64145 0a6294 2982868a6 0a6185294 1a5a62a25295 0a6359
3594868a6 0a6183893 1a3a63649693 0a6235254 23635a58a3a6 0a6183843423 1a3a63623 17a 04817a
5787a8 04505a57a 17a294 02829817a 2945787a8 02909505a57a 17a359 04817a359 3787a8389
04909793707a 17a235254 02823525817a 2343787a8384 02a23727a 017076 176168648 087857076 456576
016176294 179762729198 087857076294 297957276 017076359 176168648359 089096936376 376369649
016176235254 176168628235258 087843423837076 236376 26b 04826b 18526b 04505126b 46b4b9
0696b9098 1854696b9 0616b1b95b51 26b359 04826b359 18919326b 04149193126b 35434b46b
06b0b5b35058 18684616b1b3 0616b1b31 0ab0b2 24a48a2ab 0ab0b2185 1ab1b5b25245 0ab0b4b94 8ab8b9
0ab0b4b94185 1ab1b5b95 0ab0b2359 24a48a2ab359 0ab0b2189193 1a4ab2a24149193 0ab0b4b34354
35a58a3ab 0ab0b4b34318384 1ab1b3 17a26b 04817a26b 26b5787a8 04505a57a26b 17a46b4b9
0696b909817a 4696b95787a8 0696b909505a57a 17a26b359 04817a26b359 26b3787a8389
04909793707a26b 17a35434b46b 06b0b5b3505817a 3787a838434b46b 06b0b303707a 01707b0b2
1787b2728248 08285257b5b2 24525b57b 01707b0b4b94 1797b9198 08785707b0b4b94 57b5b9
01707b0b2359 1787b2728248359 08789383707b0b2 24749793727b 01707b0b4b34354 17b1b8b35b58
0878378434b340b07b 37b 3b7 0483b7 1853b7 0414513b7 2943b7 0290983b7 1852943b7 0290950513b7
59b5b7 04859b5b7 1891979b7 04b49b0b7071 2b5b75254 0282b5b75258 1878428272b7 02b0b7071 0a63b7
3b74868a6 0a61853b7 1a4a641453b7 0a62943b7 2982868a63b7 0a61852943b7 1a5a62a252953b7
0a659b5b7 4868a659b5b7 0a61891979b7 1a4a641491979b7 0a62b5b75254 2b5b752582868a6
0a61878428272b7 1a2a621272b7 13b1ba 04813a3ba 3ba3a5a85 04b45343b0ba 13b1ba294 02909813b1ba
2943ba3a5a85 02909505a53a3ba 15b59b1ba 04815b59b1ba 89b8ba 04b49b0ba 15b54252b1ba
0282b5ba1b15258 2ba2a4a84 02b0ba 01613b1b6 13b1b6168648 08505b53b0b6 3b4b64345 01613b1b6294
13b1b6168628298 08505b53b0b6294 2969565363b6 01615b59b1b6 15b59b1b6168648 0890969b6 49b4b6
01615b54252b1b6 15b52b5828628161b6 08684282b8b6 2b6 263673 048263673 185263673 045051263673
396946367 069673639098 185396946367 069673639095051 267279759 048267279759 189197927267
041491927267971 465675 067078758 186846167 067071 0a2a72732 2434838a7873 0a2a72732185
1a4a72732a24145 0a7079739094 3983878a7 0a7079739094185 1a9a79739195 0a5a75059092
24a48a2a7279759 0a2a72719189792 1a4a24a72792719149 0a5a75054 5878a7 0a7074718784 1a7
13a32636a 04813a32636a 2636a3a85a53 04505a53a32636a 13a39694636a 0696a3a13639098
39694636a3a5a85 0696396a3a53a05095 15a59252a26a 04815a59252a26a 2686a8289 04909a92696a
15414a46a 0656a1615058 4686a8 06a 012132 138324348 082852532 245253 014139194 139198
085053039094 395 015059092 152592128248 082892 249 014154 158 084 -
""".split()

TUNNELS = (126, 189, 219, 231)
"""Two opposite void corners, joined through the cube."""

COUNTS = np.array([0 if case == "-" else len(case) // 3 for case in CASES], dtype=np.uint8)
"""Triangles of each case, shape (256,)."""

TRIANGLES = np.zeros((256, 18), dtype=np.uint8)
"""Edges of the triangles of each case, three after three."""

for _row, _case in zip(TRIANGLES, CASES, strict=True):
    _edges = [int(digit, 16) for digit in _case if digit != "-"]
    _row[: len(_edges)] = _edges

LOWER = (0, 2, 4, 6, 8, 9, 10, 11)
"""Of the eight grid lines along a row of cubes, the edge that comes first in each cube: two lines
along which edges lie across the row in x, two in y, four along the row itself."""
LOWER_ENDS = ((0, 4), (2, 6), (0, 2), (4, 6), (0, 1), (2, 3), (4, 5), (6, 7))
"""The corners that those edges join."""

STEPS = np.array(
    [[(case >> a ^ case >> b) & 1 for a, b in LOWER_ENDS] for case in range(256)], dtype=np.int64
)
"""By how many vertices a cube of each case advances on each of the eight lines, (256, 8)."""

_SLOTS = np.array([0, 8, 1, 9, 2, 10, 3, 11, 4, 5, 6, 7], dtype=np.uint8)

SLOTS = _SLOTS[TRIANGLES]
"""``TRIANGLES`` with edges counted otherwise: slot n is the next vertex on line n before the cube,
slot 8 + n that after it, where the cube's upper edge lies."""

for _table in (COUNTS, TRIANGLES, STEPS, SLOTS):
    _table.flags.writeable = False
