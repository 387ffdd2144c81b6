"""Edits of XML by what it holds: elements moved, doubled, gone; attributes and texts that are no such thing."""

import copy
import xml.etree.ElementTree as ET
from random import Random

from tests.fuzz import values

_HEADS = (
    '<?xml version="1.0" encoding="utf-16"?>', '<?xml version="1.0" encoding="none"?>', "<!DOCTYPE x>",
    '<?xml version="1.0" encoding="latin-1"?>', '<!DOCTYPE r [<!ENTITY a "b"><!ENTITY c "&a;&a;&a;&a;">]>', "\ufeff",
    " ", '<?xml version="1.0" encoding="cp037"?>', '<?xml version="1.0" encoding="idna"?>', "<!-- -- -->", "<?x?>",
    '<?xml version="1.0" encoding="utf-7"?>', '<?xml version="1.0" encoding="hex"?>',
)  # fmt: skip


def edit(content: bytes, rng: Random) -> bytes:
    """ET.ParseError where the content is no tree any more."""
    if rng.random() < 0.03:
        return rng.choice(_HEADS).encode() + content
    root = ET.fromstring(content)
    parents = [(parent, child) for parent in root.iter() for child in parent]
    if not parents:
        return b"<x/>"
    parent, element = rng.choice(parents)
    match rng.randrange(10):
        case 0 | 1 | 2 if element.attrib:
            element.set(rng.choice(sorted(element.attrib)), values.text(rng))
        case 0 | 1 | 2 | 3:
            element.text = values.text(rng)
        case 4 if element.attrib:
            del element.attrib[rng.choice(sorted(element.attrib))]
        case 4 | 5:
            parent.remove(element)
        case 6:
            parent.append(copy.deepcopy(element))
        case 7:
            other = rng.choice(parents)[1]
            if len(ET.tostring(root)) < 500_000:
                other.append(copy.deepcopy(element))
        case 8:
            element.tag = rng.choice(parents)[1].tag
        case _ if rng.random() < 0.1:
            for _ in range(rng.choice((60, 2000))):
                element = ET.SubElement(element, element.tag)
        case _:
            other = rng.choice(parents)[1]
            element.attrib, other.attrib = dict(other.attrib), dict(element.attrib)
    # control characters are written as they are: no reader may take them, nor break on them
    return ET.tostring(root, encoding="unicode").encode("utf-8", "surrogatepass")
