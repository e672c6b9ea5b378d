"""Which reader reads which layout."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from facadelake.detect.card import Layout
from facadelake.detect.layouts.maps import MapLogitsReader, MapReader
from facadelake.detect.layouts.prototypes import PrototypeReader
from facadelake.detect.layouts.queries import RfdetrReader, RfdetrSegReader, RtdetrReader, RtdetrTripleReader
from facadelake.detect.layouts.reader import Reader
from facadelake.detect.layouts.rows import Yolov5Reader, Yolov8Reader, YoloxReader
from facadelake.detect.layouts.suppressed import Nms6Reader, RtdetrRowsReader

READERS: Mapping[Layout, Reader] = MappingProxyType(
    {
        Layout.YOLOX: YoloxReader(),
        Layout.YOLOV5: Yolov5Reader(),
        Layout.YOLOV8: Yolov8Reader(),
        Layout.NMS6: Nms6Reader(),
        Layout.YOLOV5_SEG: PrototypeReader(Yolov5Reader(), axis=1),
        Layout.YOLOV8_SEG: PrototypeReader(Yolov8Reader(), axis=0),
        Layout.NMS6_SEG: PrototypeReader(Nms6Reader(), axis=1),
        Layout.RTDETR: RtdetrReader(),
        Layout.RTDETR_TRIPLE: RtdetrTripleReader(),
        Layout.RTDETR_ROWS: RtdetrRowsReader(),
        Layout.RFDETR: RfdetrReader(),
        Layout.RFDETR_SEG: RfdetrSegReader(),
        Layout.MAP: MapReader(),
        Layout.MAP_LOGITS: MapLogitsReader(),
    }
)
