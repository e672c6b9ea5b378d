"""XMP packets: properties by namespace and name, written as attributes, elements or structures.

A packet that is not well-formed XML is read by a tolerant parser, and its ``warnings`` say so: cameras write control
characters, bare ampersands, repeated attributes and bytes of other encodings into them, and transfers cut them off.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring
from lxml import etree

# The wrapper x:xmpmeta (x:xapmeta in early versions) is optional around rdf:RDF.
_PACKET = re.compile(rb"<(x:x[ma]pmeta|rdf:RDF)\b.*?(?:</\1\s*>|\Z)", re.DOTALL)
_PADDING = re.compile(rb"<\?xpacket[^<>]*\?>|[\s\0]+|\xef\xbb\xbf")
_NOT_XML = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")
_BARE_AMPERSAND = re.compile(r"&(?!#\d+;|#x[0-9a-fA-F]+;|(?:amp|lt|gt|quot|apos);)")
_START_TAG = re.compile(r"<[^<>]+>")
_ATTRIBUTE = re.compile(r"""([\w.-]+:[\w.-]+)\s*=\s*("[^"]*"|'[^']*')""")
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_NOT_ELEMENTS = (etree.Comment, etree.ProcessingInstruction, etree.Entity)  # lxml has them among the children
# Real packets nest 5 deep (x:xmpmeta, rdf:RDF, rdf:Description, a structure, its member); deeper ones are an attack.
_MAX_DEPTH = 12


@dataclass(frozen=True, kw_only=True)
class XmpPacket:
    """Properties by ``namespace|Name``, members of a structure by ``namespace|Name/Member``.

    Namespaces are stored without a trailing slash: makers write the same one with and without it. ``warnings`` says
    what could not be read: of the packet, and of the properties that were asked for.
    """

    properties: Mapping[str, str]
    warnings: list[str] = field(default_factory=list)

    def get_text(self, namespace: str, *names: str) -> str:
        """The value of the first of the named properties that is not empty; empty where there is none."""
        for name in names:
            value = self.properties.get(f"{namespace}|{name}", "").strip()
            if value:
                return value
        return ""

    def get_number(self, namespace: str, *names: str) -> float:
        """The first of the named properties that is a finite number or fraction (``527/100``); NaN where none is."""
        for name in names:
            text = self.get_text(namespace, name)
            number = _parse_number(text)
            if math.isfinite(number):
                return number
            # Makers write "nan", "n/a", "invalid" and the like where a value is unknown.
            warning = f"XMP {name} '{text[:40]}' is not a number; not used"
            if any(character.isdigit() for character in text) and text != "0/0" and warning not in self.warnings:
                self.warnings.append(warning)
        return math.nan

    def get_sigma(self, namespace: str, name: str) -> float:
        """The named property where it is an accuracy, a positive number; NaN, with a warning, for other values."""
        text = self.get_text(namespace, name)
        number = _parse_number(text)
        if number > 0:
            return number
        if text:
            self.warnings.append(f"XMP {name} '{text[:40]}' is no accuracy; taken as not stated")
        return math.nan

    def get_step(self, namespace: str, *names: str) -> float:
        """Resolution as written of the number that ``get_number`` returns; NaN where there is none."""
        texts = (self.get_text(namespace, name) for name in names)
        return next((find_step(text) for text in texts if math.isfinite(_parse_number(text))), math.nan)

    def has_namespace(self, namespace: str) -> bool:
        """Whether there is any property of the namespace."""
        return any(key.startswith(f"{namespace}|") for key in self.properties)


def _parse_number(text: str) -> float:
    numerator, _, denominator = text.partition("/")
    try:
        number = float(numerator) / (float(denominator) if denominator else 1.0)
    except (ValueError, ZeroDivisionError):
        return math.nan
    return number if math.isfinite(number) else math.nan


def find_step(text: str) -> float:
    """Resolution of a number as written: one unit of its last decimal, or of its denominator (``527/100``)."""
    numerator, _, denominator = text.partition("/")
    if denominator:
        return abs(1 / float(denominator))
    exponent = Decimal(numerator).as_tuple().exponent
    return 10.0**exponent if isinstance(exponent, int) else math.nan


def _split_tag(tag: str) -> tuple[str, str]:
    namespace, _, name = tag.rpartition("}")
    return namespace.lstrip("{").rstrip("/"), name


class _PropertyCollector:
    """Collects the properties of a packet; ``conflicts`` are the values of those stated twice, differently."""

    def __init__(self) -> None:
        self.properties: dict[str, str] = {}
        self.conflicts: dict[str, set[str]] = {}

    def add(self, key: str, text: str) -> None:
        if key.startswith("|"):  # of a namespace that is not declared: whose it is, is unknown
            return
        first = self.properties.setdefault(key, text)
        if first.strip() != text.strip():
            self.conflicts.setdefault(key, {first.strip()}).add(text.strip())

    def collect(self, element: Element, owner: str = "", depth: int = 0) -> None:
        def make_key(tag: str) -> str:
            namespace, name = _split_tag(tag)
            return f"{owner}/{name}" if owner else f"{namespace}|{name}"

        for tag, text in element.attrib.items():
            if _split_tag(tag)[0] != _RDF:
                self.add(make_key(tag), text)
        if depth == _MAX_DEPTH:
            return
        for child in element:
            if child.tag in _NOT_ELEMENTS:
                continue
            inside = owner
            if _split_tag(child.tag)[0] not in (_RDF, "adobe:ns:meta"):
                inside = make_key(child.tag)
                if child.text and child.text.strip():
                    self.add(inside, child.text)
            self.collect(child, inside, depth + 1)

    def build_packet(self, warnings: list[str]) -> XmpPacket:
        """The packet without the properties that are stated twice, differently."""
        for key, values in sorted(self.conflicts.items()):
            self.properties.pop(key, None)
            stated = " and ".join(f"'{value[:40]}'" for value in sorted(values))
            warnings.append(f"XMP states {re.split('[|/]', key)[-1]} as {stated}; not used")
        return XmpPacket(properties=self.properties, warnings=warnings)


def _repair(packet: bytes) -> str:
    """The packet with what XML forbids replaced, so that a damaged value does not become another valid one."""
    end = max(packet.rfind(b">"), packet.rfind(b'"')) + 1  # a value that was cut off is not used
    text = _NOT_XML.sub("\ufffd", packet[:end].decode("utf-8", "replace"))
    text = _BARE_AMPERSAND.sub("&amp;", text)
    return re.sub(r'="[^"]*"', lambda value: value.group().replace("<", "&lt;"), text)


def _recover(packet: bytes, error: Exception) -> XmpPacket:
    """The properties that a tolerant parser finds in a packet that is not well-formed."""
    damage = f"the XMP packet is damaged ({error})"
    collector = _PropertyCollector()
    if b"<!ENTITY" not in packet and b"<!DOCTYPE" not in packet:
        text = _repair(packet)
        parser = etree.XMLParser(recover=True, resolve_entities=False, no_network=True, load_dtd=False)
        try:
            root = etree.fromstring(text.encode(), parser)
        except etree.XMLSyntaxError:  # nothing of it looks like XML
            root = None
        if root is not None:
            collector.collect(root)
        # The parser keeps the first of repeated attributes.
        for tag in _START_TAG.findall(text):
            stated: dict[str, str] = {}
            for name, value in _ATTRIBUTE.findall(tag):
                if stated.setdefault(name, value) != value:
                    key = next((k for k in collector.properties if re.split("[|/]", k)[-1] == name.split(":")[1]), "")
                    collector.conflicts.setdefault(key or name, set()).update({stated[name][1:-1], value[1:-1]})
    count = len(collector.properties)
    outcome = f"{count} of its properties were recovered" if count else "nothing could be recovered from it"
    return collector.build_packet([f"{damage}; {outcome}: download the photograph from the camera's card again"])


def parse_packet(packet: bytes) -> XmpPacket | None:
    """Parse a packet; None where there is none. Of a damaged one, what can be recovered, with a warning."""
    found = _PACKET.search(packet)
    if found is None:
        if _PADDING.sub(b"", packet):
            return XmpPacket(
                properties={},
                warnings=["the XMP packet is damaged (it has no x:xmpmeta); nothing could be recovered from it"],
            )
        return None
    try:
        root = fromstring(found.group())
    except (ParseError, DefusedXmlException, ValueError) as error:
        return _recover(found.group(), error)
    collector = _PropertyCollector()
    collector.collect(root)
    return collector.build_packet([])
