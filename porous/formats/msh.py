"""MSH: meshes of Gmsh, versions 2.2 and 4.1, in text or binary of either byte order.

Written is 4.1 as text, with every part: cells and faces (seen from outside) in physical groups of
their names, parts of nodes as points where they are not just the nodes of a part of faces, parts of
pairs as periodic entities where faces lie on both sides. The unit is a comment; lengths are in it.
Nodes and cells bear the mesh's numbers, from 1. In names quotes, dollars, backslashes and what is
not ASCII become underscores. Tags are not written.

Read are the nodes, the hexahedra, prisms and tetrahedra (``_msh_read``), and as parts the physical
groups and what is periodic (``_msh_groups``).
https://gmsh.info/doc/texinfo/gmsh.html#Gmsh-file-formats
"""

from __future__ import annotations

from porous.formats._msh_read import read
from porous.formats._msh_write import write_4
from porous.formats._registry import Format
from porous.values import VolumeMesh

FORMAT = Format("Gmsh mesh", (".msh",), VolumeMesh, read, (VolumeMesh,), write_4)
