"""Headers of rule packs, read independently of the product."""

import re

from facadelake.severity.rule_packs import find_rule_file


def read_severities(pack: str) -> list[str]:
    """The severities that a rule pack lists in its header, worst first."""
    header = re.search(r"^-- severities: (.+)$", find_rule_file(pack).read_text("utf-8"), re.MULTILINE)
    assert header is not None
    return [severity.strip() for severity in header[1].split(",")]
