"""Which reader reads which layout."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from facadelake.detection.card import Layout
from facadelake.detection.layouts.after_nms import Nms6Reader, RtdetrRowsReader
from facadelake.detection.layouts.reader import Reader
from facadelake.detection.layouts.segmenters import MapLogitsReader, MapReader
from facadelake.detection.layouts.transformers import RfdetrReader, RfdetrSegReader, RtdetrReader, RtdetrTripleReader
from facadelake.detection.layouts.yolo import PrototypeReader, Yolov5Reader, Yolov8Reader, YoloxReader

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
