from .rule_packs import BY_RULES as BY_RULES
from .rule_packs import GRADES as GRADES
from .rule_packs import find_rule_file as find_rule_file
from .rule_packs import grade_defects as grade_defects
