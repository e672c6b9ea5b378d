"""XMP packets: properties by namespace and name, written as attributes, elements or structures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

_PACKET = re.compile(rb"<x:xmpmeta\b.*?</x:xmpmeta>", re.DOTALL)
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
# Real packets nest 5 deep (x:xmpmeta, rdf:RDF, rdf:Description, a structure, its member); deeper ones are an attack.
_MAX_DEPTH = 12


@dataclass(frozen=True, kw_only=True)
class XmpPacket:
    """Properties by ``namespace|Name``, members of a structure by ``namespace|Name/Member``.

    Namespaces are stored without a trailing slash: makers write the same one with and without it.
    """

    properties: Mapping[str, str]

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
            number = _parse_number(self.get_text(namespace, name))
            if math.isfinite(number):
                return number
        return math.nan

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


def _split_tag(tag: str) -> tuple[str, str]:
    namespace, _, name = tag.rpartition("}")
    return namespace.lstrip("{").rstrip("/"), name


def _collect_properties(element: Element, owner: str, depth: int, properties: dict[str, str]) -> None:
    def make_key(tag: str) -> str:
        namespace, name = _split_tag(tag)
        return f"{owner}/{name}" if owner else f"{namespace}|{name}"

    for tag, text in element.attrib.items():
        if _split_tag(tag)[0] != _RDF:
            properties.setdefault(make_key(tag), text)
    if depth == _MAX_DEPTH:
        return
    for child in element:
        inside = owner
        if _split_tag(child.tag)[0] not in (_RDF, "adobe:ns:meta"):
            inside = make_key(child.tag)
            if child.text and child.text.strip():
                properties.setdefault(inside, child.text)
        _collect_properties(child, inside, depth + 1, properties)


def parse_packet(packet: bytes) -> XmpPacket | None:
    """Parse a packet; None where there is none or it is not well-formed XML (the photograph may still be valid)."""
    found = _PACKET.search(packet)
    if found is None:
        return None
    try:
        root = fromstring(found.group())
    except (ParseError, DefusedXmlException):
        return None
    properties: dict[str, str] = {}
    _collect_properties(root, "", 0, properties)
    return XmpPacket(properties=properties)
