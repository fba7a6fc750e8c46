"""A rig inspects for weeks in one process: memory, open files and threads stay what they were."""

import gc
import os
import shutil
import threading

import numpy as np
import psutil
import pytest

WARM = 200  # inspections after which everything is loaded and cached
COUNT = int(os.environ.get("ANISOSCOPE_SOAK_INSPECTIONS", "10000"))


@pytest.mark.soak
@pytest.mark.parametrize("count", [500, COUNT])
def test_inspections_one_after_another_cost_no_memory_files_or_threads(virtual_rig, plain, count):
    rig, process = virtual_rig(), psutil.Process()
    memory, handles, threads, verdicts = [], [], [], set()
    for number in range(WARM + count):
        verdicts.add(rig.inspect(f"S-{number}", methods=plain).record.verdict)
        shutil.rmtree(rig.out)
        if number >= WARM and (number - WARM) % (count // 100) == 0:
            gc.collect()
            memory.append(process.memory_info().rss)
            handles.append(process.num_fds())
            threads.append((process.num_threads(), threading.active_count()))
            print(number - WARM, f"{memory[-1] / 1e6:.1f} MB", handles[-1], threads[-1], flush=True)  # noqa: T201
    first, last = np.median(memory[:25]) / 1e6, np.median(memory[-25:]) / 1e6
    print(  # noqa: T201 - numbers for whoever runs a campaign
        f"{count} inspections: memory {first:.0f} MB, then {last:.0f} MB, files {set(handles)}, threads {set(threads)}"
    )
    assert verdicts == {"PASS"}
    assert last / first < 1.05, f"memory grew from {first:.0f} to {last:.0f} MB"
    assert len(set(handles)) == 1, f"open files: {sorted(set(handles))}"
    assert len(set(threads)) == 1, f"threads: {sorted(set(threads))}"
