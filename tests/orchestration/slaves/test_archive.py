"""Archives from strangers: refused when unsafe, nothing written outside."""

from __future__ import annotations

import stat
import zipfile

import pytest

from robomill.orchestration.errors import SlaveError
from robomill.orchestration.slaves.archive import check_xml, unpack


def archive(tmp_path, *entries):
    file = tmp_path / "a.fmu"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as z:
        for name, text in entries:
            z.writestr(name, text)
    return file


def test_unpacks(tmp_path):
    file = archive(tmp_path, ("modelDescription.xml", "x"), ("resources/a/b.txt", "y"))
    assert unpack(file, tmp_path / "out") == ["modelDescription.xml", "resources/a/b.txt"]
    assert (tmp_path / "out/resources/a/b.txt").read_text() == "y"


@pytest.mark.parametrize("name", ["../evil", "a/../../evil", "/tmp/evil", "C:/evil", "a\\..\\evil"])
def test_paths_that_escape(tmp_path, name):
    file = archive(tmp_path, ("fine", ""), (name, "x"))
    with pytest.raises(SlaveError, match=r"refused: entry .* would be written outside the folder it is unpacked to"):
        unpack(file, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "evil").exists()


def test_symbolic_links(tmp_path):
    link = zipfile.ZipInfo("link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with pytest.raises(SlaveError, match="entry 'link' is a symbolic link or a special file"):
        unpack(archive(tmp_path, (link, "/etc/passwd")), tmp_path / "out")


def test_size_and_number(tmp_path):
    file = archive(tmp_path, ("zeros", "0" * 10_000), ("b", ""))
    with pytest.raises(SlaveError, match="unpacks to 10000 bytes, at most 9999 are allowed"):
        unpack(file, tmp_path / "out", max_total=9999)
    with pytest.raises(SlaveError, match="2 entries, at most 1 are allowed"):
        unpack(file, tmp_path / "out", max_files=1)


def test_a_size_that_lies_writes_no_more_than_it_says(tmp_path):
    """The header claims 10 bytes: what comes out is cut there and fails its checksum."""
    file = archive(tmp_path, ("zeros", "0" * 1_000_000))
    data = file.read_bytes()
    size = (1_000_000).to_bytes(4, "little")
    assert data.count(size) == 2  # local header and central directory
    file.write_bytes(data.replace(size, (10).to_bytes(4, "little")))
    with pytest.raises(SlaveError, match=r"cannot be unpacked: Bad CRC-32 for file 'zeros'"):
        unpack(file, tmp_path / "out")
    assert (tmp_path / "out/zeros").stat().st_size <= 10


@pytest.mark.filterwarnings("ignore:Duplicate name")
class TestTwice:
    """Some tools write an entry twice. The same twice is one file; which of two different ones is meant, nobody knows."""

    @pytest.mark.parametrize("again", ["a/b.txt", "a//b.txt", "a/./b.txt"])
    def test_the_same(self, tmp_path, again):
        file = archive(tmp_path, ("a/", ""), ("a/b.txt", "x"), (again, "x"), ("a/", ""))
        assert unpack(file, tmp_path / "out") == ["a/b.txt"]
        assert (tmp_path / "out/a/b.txt").read_text() == "x"

    @pytest.mark.parametrize("again", ["a/b.txt", "a//b.txt"])
    def test_another(self, tmp_path, again):
        file = archive(tmp_path, ("a/b.txt", "x"), (again, "y"))
        with pytest.raises(SlaveError, match=r"entry 'a/*b.txt' is there twice with different contents \(1 and 1 bytes\)"):
            unpack(file, tmp_path / "out")
        assert not (tmp_path / "out").exists()


def test_damaged(tmp_path):
    file = archive(tmp_path, ("a", "some text that is long enough"))
    data = bytearray(file.read_bytes())
    data[35] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(SlaveError, match="cannot be unpacked"):
        unpack(file, tmp_path / "out")


def test_not_an_archive(tmp_path):
    (tmp_path / "text.fmu").write_text("hello world")
    (tmp_path / "empty.fmu").write_text("")
    (tmp_path / "folder.fmu").mkdir()
    with pytest.raises(SlaveError, match=r"text.fmu: not a zip archive, so not an FMU \(11 bytes, begins with b'hello wo'\)"):
        unpack(tmp_path / "text.fmu", tmp_path / "out")
    with pytest.raises(SlaveError, match="it is empty"):
        unpack(tmp_path / "empty.fmu", tmp_path / "out")
    with pytest.raises(SlaveError, match="it is a folder"):
        unpack(tmp_path / "folder.fmu", tmp_path / "out")


def test_missing(tmp_path):
    archive(tmp_path)
    with pytest.raises(SlaveError, match=r"b.fmu: no such file; FMUs in that folder: a.fmu"):
        unpack(tmp_path / "b.fmu", tmp_path / "out")
    with pytest.raises(SlaveError, match=r"the folder .*none does not exist either"):
        unpack(tmp_path / "none" / "b.fmu", tmp_path / "out")


class TestXml:
    """XML that explodes or reads files is refused before any parser that would let it."""

    def check(self, tmp_path, text):
        (tmp_path / "m.xml").write_text(text)
        return check_xml(tmp_path / "m.xml", tmp_path / "a.fmu")

    def test_root_attributes(self, tmp_path):
        assert self.check(tmp_path, '<root fmiVersion="2.0"><child fmiVersion="9"/></root>') == {"fmiVersion": "2.0"}

    @pytest.mark.parametrize(
        "text",
        [
            '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><r>&b;</r>',
            '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><r>&x;</r>',
            '<!DOCTYPE r SYSTEM "http://example.org/r.dtd"><r/>',
        ],
    )
    def test_document_types_and_entities(self, tmp_path, text):
        with pytest.raises(SlaveError, match=r"refused: m.xml has a document type declaration or entities \(line 1\)"):
            self.check(tmp_path, text)

    def test_not_xml(self, tmp_path):
        with pytest.raises(SlaveError, match=r"m.xml is not valid XML: mismatched tag"):
            self.check(tmp_path, "<a><b></a>")

    def test_nested_too_deep(self, tmp_path):
        with pytest.raises(SlaveError, match=r"a.fmu: refused: m.xml is nested more than 100 deep \(line 1\)"):
            self.check(tmp_path, "<a>" * 200_000 + "</a>" * 200_000)


def test_folders_that_are_parted_as_on_windows_are_said_to_be_so(tmp_path):
    with zipfile.ZipFile(tmp_path / "x.fmu", "w") as z:
        info = zipfile.ZipInfo("x")
        info.filename = info.orig_filename = "binaries\\win64/"
        z.writestr(info, b"")
    with pytest.raises(
        SlaveError, match=r"refused: entry 'binaries\\\\win64/' has a backslash, which parts folders on Windows only: pack it"
    ):
        unpack(tmp_path / "x.fmu", tmp_path / "target")
