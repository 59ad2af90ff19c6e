"""MSH2: meshes of Gmsh in version 2.2 as text, the version that most other programs read.

Gmsh itself calls files of this version ``.msh2``. Each element is listed once and is of one group:
the first part that it is in, where ``SOLID`` and ``PORE`` come before all others and ``SKIN`` after
them; a comment in the file says of which parts not all elements are listed so. Nodes and cells bear
the mesh's numbers, from 1. What ``.msh`` says of points and of pairs holds here too.
https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format-version-2
"""

from __future__ import annotations

from porous.formats._msh_read import read
from porous.formats._msh_write import write_2
from porous.formats._registry import Format
from porous.values import VolumeMesh

FORMAT = Format("Gmsh mesh 2.2", (".msh2",), VolumeMesh, read, (VolumeMesh,), write_2)
