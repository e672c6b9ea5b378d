"""The closed vocabularies of table columns."""

from __future__ import annotations

from enum import StrEnum


class DefectClass(StrEnum):
    """Class of a defect."""

    CRACK = "crack"
    SPALLING = "spalling"
    MOISTURE = "moisture"


class PhotoRole(StrEnum):
    """Use of a photograph: multi-view for the block, close-range for the defects."""

    MULTIVIEW = "multiview"
    CLOSERANGE = "closerange"


class PhotoOutcome(StrEnum):
    """Whether a file in the photographs' folder is used.

    The last four are readable and kept out of the block, unless the portfolio uses them: thermal pictures, panoramas,
    single spectral bands, and photographs of a lens that fires together with another one of its body.
    """

    ACCEPTED = "accepted"
    UNREADABLE = "unreadable"
    DUPLICATE = "duplicate"
    THERMAL = "thermal"
    PANORAMA = "panorama"
    SPECTRAL_BAND = "spectral_band"
    OTHER_LENS = "other_lens"


class PositionSource(StrEnum):
    """Metadata that a position prior was read from; ``file`` is a file that the portfolio names."""

    XMP = "xmp"
    EXIF = "exif"
    FILE = "file"
    NONE = "none"


class UtcOffset(StrEnum):
    """What tells the offset of a photograph's clock from UTC; ``unknown``: its time is taken as UTC."""

    STATED = "stated"
    GPS_TIME = "gps_time"
    SAME_CAMERA = "same_camera"
    UNKNOWN = "unknown"


class HeightDatum(StrEnum):
    """Datum of a prior height; ``unknown`` is stated, never guessed."""

    ELLIPSOIDAL = "ellipsoidal"
    ORTHOMETRIC = "orthometric"
    UNKNOWN = "unknown"


class PlacementStatement(StrEnum):
    """Statement that is compared with a campaign's placement before the commit."""

    GPS_POSITION = "gps_position"
    GPS_HEIGHT = "gps_height"
    HELD_OUT_POINTS = "held_out_points"
    SURVEYED_POINTS = "surveyed_points"
    CAMERA_HEIGHT = "camera_height"
    MODEL_IN_VIEW = "model_in_view"
    TIE_POINTS = "tie_points"
    MESH_READING = "mesh_reading"


class PlacementCheckOutcome(StrEnum):
    """Whether a statement agrees with the placement, in proportion to the sigmas of both; ``accepted``: it disagrees,
    and the portfolio accepts that with a reason."""

    AGREES = "agrees"
    DISAGREES = "disagrees"
    ACCEPTED = "accepted"
    NOT_COMPARABLE = "not_comparable"


class PoseSource(StrEnum):
    """Method of a pose; ``prior`` is metadata and no measurement, ``imported`` comes from another program."""

    SFM = "sfm"
    RESECTED = "resected"
    IMPORTED = "imported"
    PRIOR = "prior"
    UNLOCALISED = "unlocalised"

    @property
    def measured(self) -> bool:
        """Whether detections in the photograph can be registered."""
        return self in (PoseSource.SFM, PoseSource.RESECTED, PoseSource.IMPORTED)


class ControlKind(StrEnum):
    """Control that a campaign was georeferenced with."""

    GCP = "gcp"
    CAMPAIGN = "campaign"
    MODEL = "model"
    GPS = "gps"
    IMPORTED = "imported"


class PointKind(StrEnum):
    """Role of a point of the passport in the adjustment."""

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
    """Result of measuring a crack's width: stated by a person, measured, or why not.

    ``below_limit``: the crack is narrower than the photograph resolves; the limit is an upper bound.
    ``no_line``: no line was found in the box or mask. ``not_readable``: the photograph cannot be opened.
    """

    STATED = "stated"
    MEASURED = "measured"
    BELOW_LIMIT = "below_limit"
    NO_LINE = "no_line"
    NOT_READABLE = "not_readable"


class Verdict(StrEnum):
    """Verdict of a review: the detection is a defect, is none, has another class or outline; or a defect was missed."""

    CONFIRMED = "confirmed"
    REJECTED = "rejected"
    CORRECTED = "corrected"
    MISSED = "missed"


class ObservationOutcome(StrEnum):
    """Result of registering a detection on the surface."""

    REGISTERED = "registered"
    OFF_TARGET = "off_target"
    OCCLUDED = "occluded"
    MASKED = "masked"
    GRAZING = "grazing"
    OUTSIDE = "outside"
    UNLOCALISED = "unlocalised"


class PositionMethod(StrEnum):
    """Method of a defect's position."""

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
    """Source of the building's surface."""

    IFC = "ifc"
    MESH = "mesh"
    AS_BUILT = "as_built"


class CoverageOutcome(StrEnum):
    """Whether a photograph shows a cell of a facade, else what prevents it; ``docs/coverage.md`` defines the words."""

    IMAGED = "imaged"
    OBSTRUCTED = "obstructed"
    GRAZING = "grazing"
    HIDDEN_BY_MODEL = "hidden_by_model"
    NOT_IN_VIEW = "not_in_view"


class IntegrityOutcome(StrEnum):
    """Whether a view's as-built depth could be compared with the model's."""

    COMPARED = "compared"
    TOO_LITTLE_SURFACE = "too_little_surface"
    NO_MODEL = "no_model"


class TrackState(StrEnum):
    """State of a track in a campaign; ``docs/history.md`` defines the words.

    ``new``: its place was imaged well enough before, and did not show it. ``first_seen``: its place was never imaged
    well enough before. ``seen``, ``grown``, ``shrunk``: it is there, and its size is the same or changed significantly.
    ``repaired``: imaged well enough, gone, and its look changed. ``not_found``: imaged, not detected, evidence for
    neither. ``not_imaged``. ``reopened``: there again after it was repaired.
    """

    NEW = "new"
    FIRST_SEEN = "first_seen"
    SEEN = "seen"
    GROWN = "grown"
    SHRUNK = "shrunk"
    REPAIRED = "repaired"
    NOT_FOUND = "not_found"
    NOT_IMAGED = "not_imaged"
    REOPENED = "reopened"


class StateEvidence(StrEnum):
    """What the state of a track in a campaign rests on: a detection, a look at its place, a relation, or a person.

    ``no_photograph``: the place is in view, but the files for a look are not there.
    """

    DETECTED = "detected"
    LOOKS_THE_SAME = "looks_the_same"
    LOOKS_REPAIRED = "looks_repaired"
    LOOK_UNDECIDED = "look_undecided"
    HIDDEN = "hidden"
    NOT_IN_VIEW = "not_in_view"
    NO_PHOTOGRAPH = "no_photograph"
    PART_OF_OTHER = "part_of_other"
    REVIEW = "review"


class LookVerdict(StrEnum):
    """What a look at a defect's place in another campaign says.

    ``same``: it looks as it did. ``gone``: the wall is recognised, and the defect's look is not there. ``undecided``:
    imaged, evidence for neither. ``hidden``: something else is before the wall. ``not_in_view``: no photograph shows
    the place well enough. ``no_photograph``: the files of one campaign are not there.
    """

    SAME = "same"
    GONE = "gone"
    UNDECIDED = "undecided"
    HIDDEN = "hidden"
    NOT_IN_VIEW = "not_in_view"
    NO_PHOTOGRAPH = "no_photograph"


class TrackRelation(StrEnum):
    """Relation of a track to another one, or a change of its class."""

    SPLIT_FROM = "split_from"
    JOINED_INTO = "joined_into"
    CLASS_CHANGED = "class_changed"


class TrendQuantity(StrEnum):
    """Quantity of a change or a trend: a column of table ``defects``."""

    LENGTH = "length_m"
    AREA = "area_m2"
    CRACK_WIDTH = "crack_width_mm"


class OffsetOutcome(StrEnum):
    """Whether the offset of a campaign's frame from the campaigns before was estimated.

    ``refused``: the frames contradict each other beyond their sigmas; the campaign is not tracked.
    """

    FIRST = "first"
    ESTIMATED = "estimated"
    TOO_FEW = "too_few"
    REFUSED = "refused"
