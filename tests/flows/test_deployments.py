"""Deployments exist: prefect.yaml's entrypoints and their parameters, and the portfolio's schedules."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

import pytest
import yaml
from prefect import Flow

from facadelake.registry import read_portfolio

REPOSITORY = Path(__file__).parents[2]
DEPLOYMENTS: list[dict[str, Any]] = yaml.safe_load((REPOSITORY / "prefect.yaml").read_text())["deployments"]


@pytest.mark.parametrize("deployment", DEPLOYMENTS, ids=lambda deployment: str(deployment["name"]))
def test_each_entrypoint_is_a_flow_that_takes_its_parameters(deployment: dict[str, Any]) -> None:
    path, name = deployment["entrypoint"].split(":")
    assert (REPOSITORY / path).is_file()
    flow = getattr(importlib.import_module(path.removesuffix(".py").replace("/", ".")), name)
    assert isinstance(flow, Flow)
    assert flow.name == deployment["name"]
    assert set(deployment["parameters"]) <= set(inspect.signature(flow.fn).parameters)
    assert (REPOSITORY / deployment["parameters"]["portfolio"]).is_file()


def test_the_registry_that_comes_along_can_be_read() -> None:
    buildings = read_portfolio(REPOSITORY / "data" / "portfolio.yaml").buildings
    assert [building.id for building in buildings] == ["demo", "castle"]
    assert all(building.schedule is not None for building in buildings)
