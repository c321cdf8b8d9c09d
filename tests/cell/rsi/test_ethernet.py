"""KUKA's configuration file: read, written, refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from robomill.cell.rsi.ethernet import Element, Ethernet, EthernetError, read, write
from tests import SCENARIOS

FILE = SCENARIOS / "rsi" / "ethernet.xml"
PUBLISHED = """<ROOT>
   <CONFIG>
      <IP_NUMBER>192.168.1.7</IP_NUMBER>   <!-- of the partner -->
      <PORT>49152</PORT>
      <SENTYPE>ImFree</SENTYPE>
      <ONLYSEND>FALSE</ONLYSEND>
   </CONFIG>
   <SEND><ELEMENTS>
      <ELEMENT TAG="DEF_AIPos" TYPE="DOUBLE" INDX="INTERNAL" />
      <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL" />
      <ELEMENT TAG="FTC.Fx" TYPE="DOUBLE" INDX="1" UNIT="0" />
      <ELEMENT TAG="Word" TYPE="STRING" INDX="2" />
   </ELEMENTS></SEND>
   <RECEIVE><ELEMENTS>
      <ELEMENT TAG="AK.A1" TYPE="DOUBLE" INDX="1" HOLDON="1" />
      <ELEMENT TAG="AK.A2" TYPE="DOUBLE" INDX="2" HOLDON="0" />
      <ELEMENT TAG="DiO" TYPE="LONG" INDX="3" />
   </ELEMENTS></RECEIVE>
</ROOT>
"""


def test_a_file_as_kuka_has_it(tmp_path: Path) -> None:
    file = tmp_path / "a.xml"
    file.write_text(PUBLISHED)
    config = read(file)
    assert (config.address, config.port, config.sentype) == ("192.168.1.7", 49152, "ImFree")
    assert list(config.sent()) == [*(f"AIPos.A{i}" for i in range(1, 7)), "Delay.D", "FTC.Fx"]
    assert {name: e.holdon for name, e in config.received().items()} == {"AK.A1": True, "AK.A2": False, "DiO": False}
    write(config, tmp_path / "b.xml")
    assert read(tmp_path / "b.xml") == config


def test_the_file_of_the_example_is_its_own_output(tmp_path: Path) -> None:
    write(read(FILE), tmp_path / "a.xml")
    assert (tmp_path / "a.xml").read_text() == FILE.read_text()


def test_names_are_free(tmp_path: Path) -> None:
    config = Ethernet((Element("DEF_RIst"),), (Element("AKorr.A1", index="7"),), sentype="robomill", port=6008)
    write(config, tmp_path / "a.xml")
    assert read(tmp_path / "a.xml") == config


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<ROOT>", '<!DOCTYPE ROOT [<!ENTITY e SYSTEM "file:///etc/passwd">]><ROOT>', "has a document type declaration or entities"),
        ("</ROOT>", "", "is not valid XML"),
        ("ROOT>", "TOP>", "the root is <TOP>; expected <ROOT> with CONFIG, SEND and RECEIVE"),
        ("<PORT>49152</PORT>", "", "<CONFIG><PORT> is missing or empty"),
        ("49152", "99999", "PORT is '99999'; expected a whole number from 1 to 65535"),
        (">FALSE<", ">MAYBE<", "ONLYSEND is 'MAYBE'; expected TRUE or FALSE"),
        ("<SENTYPE>", "<PROTOCOL>TCP</PROTOCOL><SENTYPE>", "PROTOCOL is 'TCP'; only UDP is supported"),
        ('TAG="DiO"', 'TAG="D i"', "RECEIVE element 'D i': expected a TAG such as AK.A1 or FTC"),
        ('TYPE="LONG" INDX="3"', 'TYPE="FLOAT" INDX="3"', "RECEIVE element 'DiO': unknown TYPE 'FLOAT'"),
        ('INDX="3"', 'INDX="65"', "RECEIVE element 'DiO': INDX is '65'; expected 1 to 64"),
        ('HOLDON="0"', 'HOLDON="2"', "RECEIVE element 'AK.A2': HOLDON is '2'; expected 0 or 1"),
        ("AK.A2", "AK.A1", "AK.A1 twice; an element is there once"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = tmp_path / "a.xml"
    assert old in PUBLISHED
    file.write_text(PUBLISHED.replace(old, new))
    with pytest.raises(EthernetError) as caught:
        read(file)
    assert said in str(caught.value)


def test_no_elements_and_no_file(tmp_path: Path) -> None:
    file = tmp_path / "a.xml"
    file.write_text(PUBLISHED.partition("<RECEIVE>")[0] + "</ROOT>")
    with pytest.raises(EthernetError, match="RECEIVE has no ELEMENT"):
        read(file)
    with pytest.raises(FileNotFoundError, match=r"robomill rsi LINK.toml --config b.xml"):
        read(tmp_path / "b.xml")
