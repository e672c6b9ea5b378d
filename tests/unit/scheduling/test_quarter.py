"""A quarter on a compressed clock: fifty buildings, random uploads, an inspection of the portfolio every night."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from benchmarks.portfolio_quarter import NIGHTS, Quarter, Upload, make_portfolio

BUILDINGS = 50
UPLOADS = st.lists(
    st.builds(
        Upload,
        building=st.integers(0, BUILDINGS - 1),
        first_day=st.integers(0, NIGHTS - 1),
        pieces=st.integers(1, 4),
        late_days=st.sampled_from([0, 0, 1, 20]),
        is_killed=st.sampled_from([False, False, True]),
    ),
    min_size=30,
    max_size=80,
    unique_by=lambda one: one.key,
)


@settings(
    max_examples=3,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(uploads=UPLOADS, seed=st.integers(0, 2**16))
def test_every_upload_is_inspected_once_and_every_overdue_date_is_told_once(
    uploads: list[Upload], seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    root = tmp_path_factory.mktemp("quarter")
    quarter = Quarter(root=root, portfolio=make_portfolio(root, BUILDINGS, seed), uploads=uploads)
    quarter.run()
    assert quarter.inspected == quarter.count_expected()
    assert quarter.started_growing == 0
    assert quarter.wrong_dates == []
    assert quarter.untold == []
    assert set(quarter.told.values()) <= {1}
