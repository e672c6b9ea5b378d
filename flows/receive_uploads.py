"""Flow: one pass of the intake, in which uploads are observed, and what is complete becomes a campaign."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from httpx import HTTPError
from prefect import flow
from prefect.deployments import run_deployment
from prefect.exceptions import ObjectNotFound, PrefectException

from facadelake.core.hashing import compute_key
from facadelake.intake import (
    IntakeBusyError,
    IntakeReport,
    Upload,
    UploadState,
    describe_upload,
    receive_complete_uploads,
)
from facadelake.registry import SETTINGS_FILE, read_portfolio, read_service_settings
from flows.running import HOOKS

log = logging.getLogger("facadelake.flows")

INSPECTION = "inspect-portfolio/all"  # the deployment that inspects what waits

_NEEDS_A_PERSON = (UploadState.REFUSED, UploadState.FAILED, UploadState.STALLED)


@flow(name="receive-uploads", flow_run_name="intake", validate_parameters=True, **HOOKS)
def receive_uploads(settings: str = SETTINGS_FILE) -> IntakeReport | None:
    """Observe all sources once, and receive what is complete; a line of the log for each upload with news.

    Args:
        settings: path of the service's settings.

    Returns:
        the uploads and what is new; None where another process receives uploads at the moment.

    Raises:
        InputDataError: the settings or the portfolio have mistakes.
        StoreError: the intake's ledger cannot be read or written.
    """
    service = read_service_settings(Path(settings))
    try:
        report = receive_complete_uploads(read_portfolio(Path(service.portfolio)).buildings, service)
    except IntakeBusyError as error:
        log.info("%s", error)
        return None
    for upload in report.news:
        level = logging.WARNING if upload.state in _NEEDS_A_PERSON else logging.INFO
        log.log(level, "%s", describe_upload(upload))
    received = [upload for upload in report.news if upload.state is UploadState.RECEIVED]
    if received:
        _start_inspections(received)
    for source in report.new_problems:
        log.warning("%s: %s", source.building_id, source.problem)
    return report


def _start_inspections(received: Sequence[Upload]) -> None:
    """Have what was received inspected now, where the service runs; else the next inspection of the portfolio does."""
    key = compute_key({"received": sorted((one.building_id, one.folder, str(one.received_at)) for one in received)})
    try:
        run_deployment(INSPECTION, timeout=0, as_subflow=False, idempotency_key=key)
    except ObjectNotFound:
        log.info("no deployment '%s' on this server: what was received waits for the next inspection", INSPECTION)
    except (PrefectException, HTTPError) as error:  # what was received is received
        log.warning("what was received waits for the next inspection of the portfolio: %s", error)
