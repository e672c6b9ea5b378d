"""The reader of each layout."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from facadelake.detection.card import OutputLayout
from facadelake.detection.layouts.after_nms import Nms6Reader, RtdetrRowsReader
from facadelake.detection.layouts.output_reader import OutputReader
from facadelake.detection.layouts.segmenters import MapLogitsReader, MapReader
from facadelake.detection.layouts.transformers import RfdetrReader, RfdetrSegReader, RtdetrReader, RtdetrTripleReader
from facadelake.detection.layouts.yolo import PrototypeReader, Yolov5Reader, Yolov8Reader, YoloxReader

READERS: Mapping[OutputLayout, OutputReader] = MappingProxyType(
    {
        OutputLayout.YOLOX: YoloxReader(),
        OutputLayout.YOLOV5: Yolov5Reader(),
        OutputLayout.YOLOV8: Yolov8Reader(),
        OutputLayout.NMS6: Nms6Reader(),
        OutputLayout.YOLOV5_SEG: PrototypeReader(Yolov5Reader(), axis=1),
        OutputLayout.YOLOV8_SEG: PrototypeReader(Yolov8Reader(), axis=0),
        OutputLayout.NMS6_SEG: PrototypeReader(Nms6Reader(), axis=1),
        OutputLayout.RTDETR: RtdetrReader(),
        OutputLayout.RTDETR_TRIPLE: RtdetrTripleReader(),
        OutputLayout.RTDETR_ROWS: RtdetrRowsReader(),
        OutputLayout.RFDETR: RfdetrReader(),
        OutputLayout.RFDETR_SEG: RfdetrSegReader(),
        OutputLayout.MAP: MapReader(),
        OutputLayout.MAP_LOGITS: MapLogitsReader(),
    }
)
