"""The ensemble kernels: 10^4 to 10^5 trajectories a second.

run.py takes initial states (rows.py) through a compiled kernel; steps.py says how many steps each needs for what is asked for
(tolerance.py). The source of a kernel is generated from the equations of :mod:`sunspin.dynamics.gyrostat` (codegen.py, series.py)
for lanes that advance together (lanes.py), by one of two methods: series_lanes.py for directions, split_lanes.py with the
numbers of principal.py for distributions (deposit.py). compiled.py puts it into the hand-written text of the *_template.py
files and has it compiled, once for each structure.
"""

from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.ensemble.ahead import compile_all
from sunspin.dynamics.ensemble.codegen import RowLayout
from sunspin.dynamics.ensemble.compiled import OUTCOME_TEXT, Outcome, kernel
from sunspin.dynamics.ensemble.rows import Rows, mode_table, work_array
from sunspin.dynamics.ensemble.run import (
    BlockResult,
    Mask,
    check_commands,
    prepare,
    run_rows,
    structure_of,
    structures,
)
from sunspin.dynamics.ensemble.tolerance import EMD_ERROR, accuracy

__all__ = [
    "EMD_ERROR",
    "OUTCOME_TEXT",
    "BlockResult",
    "Bodies",
    "Mask",
    "Outcome",
    "RowLayout",
    "Rows",
    "accuracy",
    "check_commands",
    "compile_all",
    "kernel",
    "mode_table",
    "prepare",
    "run_rows",
    "structure_of",
    "structures",
    "work_array",
]
