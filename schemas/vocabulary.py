"""The closed lists of words that tables use."""

from __future__ import annotations

from enum import StrEnum


class DefectClass(StrEnum):
    """What a defect is."""

    CRACK = "crack"
    SPALLING = "spalling"
    MOISTURE = "moisture"


class PhotoRole(StrEnum):
    """What a photograph is for: multi-view carries the block, close-range shows the defects."""

    MULTIVIEW = "multiview"
    CLOSERANGE = "closerange"


class PhotoOutcome(StrEnum):
    """What became of a file in the photographs' folder."""

    ACCEPTED = "accepted"
    UNREADABLE = "unreadable"
    DUPLICATE = "duplicate"


class PositionSource(StrEnum):
    """Where a position prior was read from."""

    XMP = "xmp"
    EXIF = "exif"
    NONE = "none"


class HeightDatum(StrEnum):
    """What a prior height refers to; ``unknown`` is said, never guessed."""

    ELLIPSOIDAL = "ellipsoidal"
    ORTHOMETRIC = "orthometric"
    UNKNOWN = "unknown"


class PoseSource(StrEnum):
    """How a pose was found: ``prior``, the photograph's own word, is no measurement, ``imported`` another program's."""

    SFM = "sfm"
    RESECTED = "resected"
    IMPORTED = "imported"
    PRIOR = "prior"
    UNLOCALISED = "unlocalised"

    @property
    def measured(self) -> bool:
        """Whether what the photograph shows can be put on a wall."""
        return self in (PoseSource.SFM, PoseSource.RESECTED, PoseSource.IMPORTED)


class ControlKind(StrEnum):
    """What placed the campaign on the globe."""

    GCP = "gcp"
    CAMPAIGN = "campaign"
    MODEL = "model"
    GPS = "gps"
    IMPORTED = "imported"


class PointKind(StrEnum):
    """What a point of the passport is to the adjustment."""

    CONTROL = "control"
    HELD_OUT = "held_out"
    CHECK = "check"
    GPS = "gps"


class DetectionOutcome(StrEnum):
    """Whether a detection can be registered at all."""

    ACCEPTED = "accepted"
    UNKNOWN_CLASS = "unknown_class"
    OUTSIDE_IMAGE = "outside_image"
    UNKNOWN_PHOTO = "unknown_photo"
    BAD_BOX = "bad_box"


class CrackWidthOutcome(StrEnum):
    """What is known of a crack's width: stated by a person, measured, or why not.

    ``below_limit``: there is a line, but it is narrower than the photograph can tell; the limit is an upper bound.
    ``no_line``: nothing in the box or mask stands out as a line. ``not_readable``: the photograph cannot be opened.
    """

    STATED = "stated"
    MEASURED = "measured"
    BELOW_LIMIT = "below_limit"
    NO_LINE = "no_line"
    NOT_READABLE = "not_readable"


class Verdict(StrEnum):
    """A person's word on a detection: it is a defect, it is none, it is another or lies otherwise; or none was found
    where a defect is."""

    CONFIRMED = "confirmed"
    REJECTED = "rejected"
    CORRECTED = "corrected"
    MISSED = "missed"


class ObservationOutcome(StrEnum):
    """What became of a detection on its way to the surface."""

    REGISTERED = "registered"
    OFF_TARGET = "off_target"
    OCCLUDED = "occluded"
    MASKED = "masked"
    GRAZING = "grazing"
    OUTSIDE = "outside"
    UNLOCALISED = "unlocalised"


class PositionMethod(StrEnum):
    """What a defect's position rests on."""

    SURFACE = "surface"
    TRIANGULATED = "triangulated"


class MergeDecision(StrEnum):
    """Whether two neighbouring observations are one defect."""

    JOINED = "joined"
    APART = "apart"


class MergeReason(StrEnum):
    """Why two observations are one defect, or are not; ``docs/tables.md`` says which columns decided."""

    GEOGRAPHY = "geography"
    GEOGRAPHY_AND_IMAGE = "geography_and_image"
    CUT_BY_SEAM = "cut_by_seam"
    OUTVOTED = "outvoted"
    LOOKS_DIFFERENT = "looks_different"
    TOO_FAR = "too_far"
    NO_OVERLAP = "no_overlap"
    SAME_PHOTOGRAPH = "same_photograph"
    GROUP_DISAGREES = "group_disagrees"
    OTHER_CLASS = "other_class"


class SurfaceKind(StrEnum):
    """What the building's surface was made of."""

    IFC = "ifc"
    MESH = "mesh"
    AS_BUILT = "as_built"


class IntegrityOutcome(StrEnum):
    """Whether a view's as-built depth could be compared with the model's."""

    COMPARED = "compared"
    TOO_LITTLE_SURFACE = "too_little_surface"
    NO_MODEL = "no_model"
