from .description import GRADED_BY_RULES as GRADED_BY_RULES
from .description import describe_severity as describe_severity
from .rule_packs import GRADE_COLUMNS as GRADE_COLUMNS
from .rule_packs import RulePack as RulePack
from .rule_packs import find_rule_file as find_rule_file
from .rule_packs import grade_defects as grade_defects
from .rule_packs import read_rule_pack as read_rule_pack
