"""3MF files that are damaged, lie, or are made to harm: the right answer, or one line why not."""

import io
import re
import warnings
import zipfile
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_hostile import judged
from test_threemf import CORNERS, HEAD, TURN, ball, group, item, lattice, mesh, written
from test_threemf import package as packed

from porous.formats import threemf

GOOD = {
    "ours": written(ball()),
    "others": packed(mesh(1, name="a") + group(2, ("1", TURN), ("1", "")), item(2, TURN) + item(1)),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("hostile")


def archive(*members, method=zipfile.ZIP_DEFLATED):
    """Return an archive of names and texts; a good model where none of that name is given."""
    stream = io.BytesIO()
    given_names = {name for name, _ in members}
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as out:
        warnings.simplefilter("ignore")  # of two members of one name
        for name, text in (("_rels/.rels", threemf.ROOTS), ("3D/3dmodel.model", MODEL)):
            if name not in given_names:
                out.writestr(name, text)
        for name, text in members:
            if text is not None:
                out.writestr(name, text)
    return stream.getvalue()


MODEL = (
    f"{HEAD.format('millimeter')}<resources>{mesh(1)}</resources><build>{item(1)}</build></model>"
)
RELATION = f'<Relationship Target="/3D/3dmodel.model" Id="r" Type="{threemf.MODEL}"/>'


def model(text):
    return archive(("3D/3dmodel.model", text))


def rels(*rows):
    return archive(("_rels/.rels", f"<Relationships>{''.join(rows)}</Relationships>"))


def renamed(data, old, new):
    """Return an archive in which a name is another of the same length, in both its places."""
    assert len(old) == len(new)
    return data.replace(old, new)


def bomb():
    """Return 66 KB that unpack to 64 MiB of blanks within a model; it says so."""
    machine = zlib.compressobj(9, wbits=-15)
    head, tail = MODEL[:-8].encode(), b"</model>"
    block = b" " * 2**22
    crc = zlib.crc32(head)
    pieces = [machine.compress(head)]
    size = len(head)
    for _ in range(16):
        pieces.append(machine.compress(block))
        crc, size = zlib.crc32(block, crc), size + len(block)
    pieces += [machine.compress(tail), machine.flush()]
    body = b"".join(pieces)
    return raw(body, size + len(tail), zlib.crc32(tail, crc))


def raw(body, size, crc=0, *, name=b"3D/3dmodel.model", method=8):
    """Return an archive whose model is these packed bytes, and says what it likes of itself."""
    plain = archive(("3D/3dmodel.model", None))
    start = plain.index(b"PK\x01\x02")
    end = plain.index(b"PK\x05\x06")
    fields = (
        (20).to_bytes(2, "little") + bytes(2) + method.to_bytes(2, "little") + b"\0\0\x21\0"
        + crc.to_bytes(4, "little") + len(body).to_bytes(4, "little") + size.to_bytes(4, "little")
        + len(name).to_bytes(2, "little") + bytes(2)
    )  # fmt: skip
    local = b"PK\x03\x04" + fields + name + body
    entry = b"PK\x01\x02" + b"\x14\0" + fields + bytes(10) + start.to_bytes(4, "little") + name
    directory = plain[start:end] + entry
    tail = bytearray(plain[end:])
    tail[8:12] = (2).to_bytes(2, "little") * 2
    tail[12:20] = len(directory).to_bytes(4, "little") + (start + len(local)).to_bytes(4, "little")
    return plain[:start] + local + directory + bytes(tail)


def packed_model(text):
    machine = zlib.compressobj(9, wbits=-15)
    return machine.compress(text) + machine.flush()


def doctype(text):
    return model(text + MODEL)


LAUGHS = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
TOWER = mesh(1) + "".join(group(i, (str(i - 1), ""), (str(i - 1), "")) for i in range(2, 60))
CHAIN = mesh(1) + "".join(group(i, (str(i - 1), "")) for i in range(2, 500))
COPIES = mesh(1) + group(2, *[("1", "")] * 4_000)
EMPTY = group(1) + "".join(group(i, (str(i - 1), ""), (str(i - 1), "")) for i in range(2, 60))
NEEDS = HEAD[:-1] + ' xmlns:q="urn:other" requiredextensions="%s">'
MANY = "".join(f'<vertex x="{i}" y="0" z="0"/>' for i in range(1000))
PATH = (
    'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" '
    'p:path="/3D/other.model" objectid'
)


def is_tetrahedron(value):
    return value.volume == pytest.approx(5.0)


def with_corner(x):
    return packed(mesh(1, corners=[*CORNERS[:3], (0, 0, x)]), item(1))


def with_text(old, new, *, count=1):
    assert old in MODEL
    return model(MODEL.replace(old, new, count))


FILES = {
    # the ten classes
    "zip bomb": (bomb(), "the model would take 67109[0-9]* bytes; the file has"),
    "zip bomb of 4 GiB": (raw(packed_model(b" " * 2**20), 2**32 - 2), "would take 4294967294"),
    "zip bomb that lies low": (
        raw(packed_model(b" " * 2**26), 5000),
        "the model is damaged|XML: no element found",
    ),
    "billion laughs": (
        doctype(f'<!DOCTYPE model [<!ENTITY a0 "lol">{LAUGHS}]>'),
        "document types and entities are not read",
    ),
    "external entity": (
        doctype('<!DOCTYPE model [<!ENTITY x SYSTEM "file:///etc/passwd">]>'),
        "document types and entities are not read",
    ),
    "external document type": (
        doctype('<!DOCTYPE model SYSTEM "/etc/passwd">'),
        "document types and entities are not read",
    ),
    "component of itself": (
        packed(mesh(1) + group(2, ("2", "")), item(2)),
        "an object that is used: got '2'; wanted the id of one that stands before",
    ),
    "components in a circle": (
        packed(group(1, ("2", "")) + group(2, ("1", "")), item(1)),
        "is used: got '2'; wanted",
    ),
    "index out of range": (
        with_text('v3="2"', 'v3="77"'),
        "triangles name vertices 0 to 77; there are 4",
    ),
    "index negative": (
        with_text('v3="2"', 'v3="-1"'),
        "triangles name vertices -1 to 3; there are",
    ),
    "nan": (with_corner("nan"), "surface points: point 3 is .*nan"),
    "inf": (with_corner("1e999"), "surface points: point 3 is .*inf"),
    "member that leads out": (
        archive(("../../etc/x", b"x")),
        r"a member: got '../../etc/x'; wanted names of files inside",
    ),
    "member of the root": (archive(("/etc/passwd", b"x")), "a member: got '/etc/passwd'; wanted"),
    "member of a drive": (archive(("C:x", b"x")), "a member: got 'C:x'; wanted names of files"),
    "member of Windows": (archive(("..\\x", b"x")), r"a member: got '..\\\\x'; wanted names"),
    "member with a null": (
        renamed(archive(("3D/a", b"x")), b"3D/a", b"3D/\0"),
        r"a member: got '3D/.x00'; wanted",
    ),
    "two members of one name": (
        archive(("3D/3dmodel.model", MODEL), ("3D/3dmodel.model", MODEL)),
        "a member: got '3D/3dmodel.model'; wanted each name once",
    ),
    "two members of one name in other letters": (
        archive(("3D/3DMODEL.model", MODEL), ("3D/3dmodel.model", MODEL)),
        "a member: got '3D/3dmodel.model'; wanted each name once",
    ),
    "no relations": (archive(("_rels/.rels", None)), "no _rels/.rels, which names the model"),
    "broken relations": (archive(("_rels/.rels", "<Rel")), "XML: unclosed token"),
    "relations of nothing": (rels(), "_rels/.rels: got '0 models'; wanted one model"),
    "relations of two": (rels(RELATION, RELATION), "_rels/.rels: got '2 models'; wanted one"),
    "relation to nowhere": (
        rels(RELATION.replace("3dmodel.model", "other.model")),
        "the model that _rels/.rels names: got '3D/other.model'; wanted a file of the archive",
    ),
    "relation to another file": (
        rels(RELATION.replace("/3D/3dmodel.model", "../../../etc/passwd")),
        "names: got '../../../etc/passwd'; wanted a file of the archive",
    ),
    "relation outside": (
        rels(RELATION.replace("Id=", 'TargetMode="External" Id=')),
        "got '1 models'; wanted one",
    ),
    "relations of 1 MB": (
        archive(("_rels/.rels", "<a>" + " " * 10**6 + "</a>")),
        "rels would take 1000007 bytes",
    ),
    "relations with entities": (
        archive(("_rels/.rels", "<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>")),
        "entities are not",
    ),
    "no model": (archive(("3D/3dmodel.model", None)), "got '3D/3dmodel.model'; wanted a file of"),
    "unit inch": (with_text("millimeter", "inch"), lambda value: value.unit == "in"),
    "unit micron": (with_text("millimeter", "micron"), lambda value: value.unit == "um"),
    "unit of another world": (with_text("millimeter", "parsec"), "unit: got 'parsec'; wanted one"),
    # the archive
    "cut": (GOOD["ours"][:-40], "no table of contents at its end"),
    "cut in the middle": (GOOD["ours"][: len(GOOD["ours"]) // 2], "no table of contents"),
    "not a zip": (b"<model/>" * 100, "no table of contents at its end; wanted a zip archive"),
    "table of contents of 4 GiB": (
        GOOD["ours"][:-10] + b"\xfe\xff\xff\xff" + GOOD["ours"][-6:],
        "the table of contents would take|is damaged",
    ),
    "sum that is wrong": (
        raw(packed_model(MODEL.encode()), len(MODEL), 12345),
        "the model is damaged .Bad CRC",
    ),
    "packed otherwise": (
        raw(b"x" * 50, 50, method=12),
        "compression of the model: got 12; wanted stored",
    ),
    "stored and said longer": (
        raw(b"x" * 50, 5000, method=0),
        "the model would take 5000 bytes; the file has 50 left",
    ),
    "packed bytes damaged": (raw(b"\xff" * 50, 500), "the model is damaged"),
    "encrypted": (
        GOOD["others"].replace(b"PK\x01\x02\x14\x03\x14\0\0", b"PK\x01\x02\x14\x03\x14\0\1"),
        "is encrypted or of a kind that is not read",
    ),
    # the markup
    "another root": (model("<html/>"), "root: got 'html'; wanted a model of the 3MF core"),
    "a model of nobody": (model("<model/>"), "root: got 'model'; wanted a model of the 3MF core"),
    "no end": (model(MODEL[:-10]), "XML: "),
    "not XML": (model("\0" * 1000), "XML: "),
    "blanks": (model(" " * 10**6), "XML: no element found"),
    "nested deep": (model(MODEL[:70] + ">" + "<a>" * 10**5), "XML: "),
    "nested deep within": (with_text("<mesh>", "<a>" * 100), "XML: nested over 64 deep"),
    "a tag of 1 MB": (with_text("<mesh>", "<a " + "b" * 10**6), "XML: a tag of more than 262144"),
    "a comment of 1 MB": (
        with_text("<mesh>", "<!--" + "b" * 10**6 + "--><mesh>"),
        "XML: a tag of more than 262144",
    ),
    "many attributes": (
        with_text("<mesh>", "<mesh " + " ".join(f'a{i}=""' for i in range(10**5)) + ">"),
        "XML: a tag of more than 262144",
    ),
    "many elements of others": (
        with_text("<mesh>", '<o xmlns="urn:o">' + "<b/>" * 100_000 + "</o><mesh>"),
        is_tetrahedron,
    ),
    "many namespaces": (
        with_text("<mesh>", "<mesh " + " ".join(f'xmlns:n{i}="u{i}"' for i in range(900)) + ">"),
        is_tetrahedron,
    ),
    "UTF-16": (model(MODEL.encode("utf-16")), is_tetrahedron),
    "encoding unknown": (model('<?xml version="1.0" encoding="klingon"?>' + MODEL), "XML: "),
    "encoding of many bytes": (model('<?xml version="1.0" encoding="utf-7"?>' + MODEL), "XML: "),
    "entity unknown": (with_text("<mesh>", "&nbsp;<mesh>"), "XML: undefined entity"),
    # numbers
    "no z": (with_text(' z="5"', ""), "vertex 3 of object 1: got '0 0'; wanted numbers x, y and z"),
    "words": (with_text('z="5"', 'z="five"'), "vertex 3 of object 1: got '0 0 five'; wanted"),
    "commas": (with_text('z="5"', 'z="5,0"'), "vertex 3 of object 1: got '0 0 5,0'; wanted"),
    "a number of 60000 digits": (
        with_text('z="5"', f'z="{"9" * 60_000}"'),
        "surface points: point 3 is .*inf",
    ),
    "no v2": (with_text(' v2="2"', ""), "triangle 0 of object 1: got '0 1 0'; wanted vertices"),
    "corners in halves": (
        with_text('v2="2"', 'v2="1.5"'),
        "triangle 0 of object 1: got '0 1.5 1 0",
    ),
    "corner of 30 digits": (
        with_text('v2="2"', f'v2="{10**30}"'),
        "triangle 0 of object 1: got '0 10+",
    ),
    "corner of 5000 digits": (with_text('v2="2"', f'v2="{"9" * 5000}"'), "triangle 0 of object 1"),
    "a transform of eleven": (packed(mesh(1), item(1, TURN[2:])), "transform: got .*wanted 12 num"),
    "a transform of words": (packed(mesh(1), item(1, "x " * 12)), "transform: got 'x x.*numbers"),
    "a transform of nan": (packed(mesh(1), item(1, "nan " * 12)), "transform: .*wanted finite"),
    "a transform that flattens": (
        packed(mesh(1), item(1, TURN.replace("-1", "0"))),
        "transform: .*and do not flatten",
    ),
    "a transform beyond numbers": (
        packed(mesh(1), item(1, "1e300 0 0 0 1e300 0 0 0 1e-300 0 0 0")),
        lambda v: v.points.max() > 1,
    ),
    "transforms that overflow": (
        packed(
            mesh(1) + group(2, ("1", "1e200 0 0 0 1 0 0 0 1 0 0 0")),
            item(2, "1e200 0 0 0 1 0 0 0 1 0 0 0"),
        ),
        "points: point 0 is .*nan|points: point 1 is .*inf",
    ),
    # objects
    "an id twice": (
        packed(mesh(1) + mesh(1), item(1)),
        "id of an object: got '1'; wanted one that",
    ),
    "no id": (
        with_text('<object id="1"', "<object"),
        "id of an object: got ''; wanted one that no",
    ),
    "an object inside another": (
        with_text("<mesh>", '<object id="2"></object><mesh>'),
        "id of an object: got '2'",
    ),
    "a vertex of nobody": (
        packed('<vertex x="0" y="0" z="0"/>', ""),
        "a vertex that is in no object",
    ),
    "a triangle of nobody": (
        packed('<triangle v1="0" v2="0" v3="0"/>', ""),
        "a triangle that is in no object",
    ),
    "a component of nobody": (
        packed('<component objectid="1"/>', ""),
        "a component that is in no object",
    ),
    "nothing is built": (packed(mesh(1), ""), "nothing is built; wanted at least one item"),
    "an item that is not there": (packed(mesh(1), item(4)), "is used: got '4'; wanted the id"),
    "an item of nothing": (packed(mesh(1), "<item/>"), "is used: got None; wanted the id of one"),
    "no triangles": (packed(group(1), item(1)), "no triangles; wanted at least one"),
    "vertices alone": (
        packed(f'<object id="1"><mesh><vertices>{MANY}</vertices></mesh></object>', item(1)),
        "no triangles; wanted at least one",
    ),
    "beams alone": (written(lattice()), "2 beams and no triangles; wanted"),
    "many objects": (
        packed("".join(group(i) for i in range(5000)) + mesh("x"), item("x")),
        "more than 4096 objects",
    ),
    "many items": (packed(mesh(1), item(1) * 100_000), "objects are used more than 16384 times"),
    "many vertices": (
        packed(mesh(1, corners=CORNERS + [(0, 0, 0)] * 60_000), item(1)),
        lambda value: len(value.points) == 60_004,
    ),
    "many triangles": (
        model(
            MODEL.replace(
                "</triangles>", '<triangle v1="0" v2="0" v3="0"/>' * 60_000 + "</triangles>"
            )
        ),
        lambda value: len(value.triangles) == 60_004,
    ),
    "a million vertices of 4 KB": (
        packed(mesh(1, corners=CORNERS + [(0, 0, 0)] * 1_000_000), item(1)),
        "the model would take 280005[0-9]* bytes; the file has",
    ),
    "a tower of copies": (packed(TOWER, item(59)), "copies of objects; wanted at most 4096"),
    "a tower of nothing": (packed(EMPTY, item(59)), "copies of objects; wanted at most 4096"),
    "a chain of objects": (packed(CHAIN, item(499)), "put together of others over 64 deep"),
    "many copies": (packed(COPIES, item(2)), lambda value: len(value.triangles) == 16_000),
    "copies of copies": (packed(COPIES, item(2) * 2), "8002 copies of objects; wanted at most"),
    "an object of another file": (
        packed(mesh(1), f'<item {PATH}="1"/>'),
        "an object: got '/3D/other.model'; wanted all obj",
    ),
    "an extension that is not known": (
        packed(mesh(1), item(1), head=NEEDS % "q"),
        "needs: got 'urn:other'; wanted none, or",
    ),
    "an extension of no name": (
        packed(mesh(1), item(1), head=NEEDS % "zz"),
        "that the model needs: got 'zz'; wanted",
    ),
    "a name that steers terminals": (
        packed(mesh(1, name="&#x9b;31m&#10;"), item(1)),
        is_tetrahedron,
    ),
    "an id that steers terminals": (
        packed(mesh(1), item("&#x9b;31m&#10;")),
        "is used: got .*31m.*; wanted the id of one",
    ),
}


@pytest.mark.parametrize("name", GOOD)
def test_the_good_files_are_good(folder, name):
    assert not isinstance(judged(folder, ".3mf", GOOD[name]), str)


@pytest.mark.parametrize("name", FILES)
def test_hostile_files(folder, name):
    data, expected = FILES[name]
    outcome = judged(folder, ".3mf", data)
    if isinstance(expected, str):
        assert isinstance(outcome, str), outcome
        assert re.search(expected, outcome), outcome
    else:
        assert not isinstance(outcome, str), outcome
        assert expected(outcome)


def test_copies_of_a_large_object_stay_within_the_file_s_measure(folder):
    """16 MiB of copies are always allowed, and 256 bytes for each that the model is packed to."""
    vertices = "".join(f'<vertex x="{i}" y="{i % 7}" z="{i % 5}"/>' for i in range(4000))
    sides = "".join(f'<triangle v1="{i}" v2="{i + 1}" v3="{i + 2}"/>' for i in range(3998))
    large = (
        f'<object id="1"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{sides}</triangles></mesh></object>"
    )
    data = packed(large + group(2, *[("1", "")] * 4000), item(2))
    outcome = judged(folder, ".3mf", data)
    assert re.search("what is built would take 767808000 bytes; the file has .* left", outcome)


# --- chance --------------------------------------------------------------------------------------

WORDS = ["", "0", "-1", "99", "nan", "1e999", "x", '"', "<", ">", "/>", "&", "</mesh>", "id", "\0"]


@given(
    changes=st.lists(st.tuples(st.floats(0, 0.999), st.sampled_from(WORDS)), min_size=1, max_size=9)
)
@settings(max_examples=60)
def test_words_of_the_model_that_are_exchanged(folder, changes):
    with zipfile.ZipFile(io.BytesIO(GOOD["others"])) as good:
        words = re.split(r'([\s"<>=]+)', good.read("3D/3dmodel.model").decode())
    for place, word in changes:
        words[int(place * len(words))] = word
    judged(folder, ".3mf", model("".join(words)))


@given(
    name=st.sampled_from(sorted(GOOD)),
    changes=st.lists(st.tuples(st.floats(0, 0.999), st.integers(0, 255)), min_size=1, max_size=9),
    length=st.floats(0.3, 1) | st.just(1.0),
)
@settings(max_examples=60)
def test_bytes_of_the_archive_that_are_exchanged(folder, name, changes, length):
    data = bytearray(GOOD[name])
    for place, value in changes:
        data[int(place * len(data))] = value
    judged(folder, ".3mf", bytes(data[: max(int(length * len(data)), 1)]))


@pytest.mark.slow
@pytest.mark.parametrize("name", GOOD)
def test_many_bits_and_bytes_at_once(folder, name):
    rng = np.random.default_rng(len(name))
    for _ in range(300):
        damaged = bytearray(GOOD[name])
        for _ in range(int(rng.integers(1, 6))):
            place, width = int(rng.integers(len(damaged))), int(rng.integers(1, 9))
            if rng.integers(2):
                damaged[place : place + width] = rng.bytes(width)
            else:
                del damaged[place : place + width]
        judged(folder, ".3mf", bytes(damaged))
