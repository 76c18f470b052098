"""Time and memory of stages."""

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from vfm_sdm.studies.protocol import cost as cost_module
from vfm_sdm.studies.protocol.cost import Cost, measure_cost
from vfm_sdm.studies.protocol.runs import _keep_costs

STAGES = ("camera parameter estimation", "point tracking")


def costs_of(seconds):
    return [Cost(task, "all frames", 2, seconds, 100.0) for task in STAGES]


def wait(seconds):
    """Sleeps at least so long."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        time.sleep(max(0, end - time.perf_counter()))


def test_time_is_that_of_the_block():
    with measure_cost("waiting", "nothing", calls=3) as cost:
        wait(0.1)
    assert (cost.task, cost.input_size, cost.calls) == ("waiting", "nothing", 3)
    assert 0.1 <= cost.seconds < 5


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the system does not tell the memory")
def test_memory_is_the_largest_meanwhile():
    size_mb = 300
    with measure_cost("nothing", "") as before:
        pass
    with measure_cost("something", "") as during:
        held = np.ones(size_mb * 125_000)
        wait(0.2)
        del held
    with measure_cost("nothing", "") as after:
        pass
    assert before.peak_memory_mb > 10
    assert during.peak_memory_mb == pytest.approx(before.peak_memory_mb + size_mb, abs=60)
    assert after.peak_memory_mb < during.peak_memory_mb - size_mb / 2


def test_a_system_that_does_not_tell_the_memory_gives_nan(monkeypatch, tmp_path):
    monkeypatch.setattr(cost_module, "_STATM", tmp_path / "none")
    with measure_cost("something", "") as cost:
        wait(0.05)
    assert np.isnan(cost.peak_memory_mb)
    assert cost.seconds >= 0.05


def test_a_block_that_fails_has_a_cost_and_leaves_no_thread():
    threads = threading.active_count()
    costs = []

    def fail():
        with measure_cost("failing", "") as cost:
            costs.append(cost)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert np.isfinite(costs[0].seconds)
    assert threading.active_count() == threads


def test_costs_of_reused_stages_are_those_of_when_they_were_run(tmp_path):
    path = tmp_path / "costs.json"
    first, again = costs_of(9.0), costs_of(0.1)
    assert _keep_costs(path, first, []) == first
    assert _keep_costs(path, again, ["cameras"]) == [first[0], again[1]]
    assert _keep_costs(path, costs_of(0.2), ["cameras", "tracking"]) == [first[0], again[1]]
    assert _keep_costs(path, costs_of(7.0), []) == costs_of(7.0)


def test_a_cost_that_was_never_measured_is_that_of_now(tmp_path):
    assert _keep_costs(tmp_path / "costs.json", costs_of(0.1), ["cameras", "tracking"]) == costs_of(0.1)


def test_costs_of_other_stages_are_not_forgotten(tmp_path):
    path = tmp_path / "costs.json"
    _keep_costs(path, costs_of(9.0), [])
    _keep_costs(path, costs_of(9.0)[:1], ["cameras"])
    assert set(json.loads(path.read_text())) == set(STAGES)
