"""Published data sets, with their sources."""

from types import SimpleNamespace

import numpy as np
import pytest

# NIST/SEMATECH e-Handbook of Statistical Methods, 6.3.2.2: flow rate of ten batches
NIST_FLOWRATE = np.array([49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1])

# the same, 6.3.2.4: twenty values, target 50, s 2.0539, lambda 0.3; and their EWMA as printed there
NIST_EWMA_VALUES = np.array(
    [
        52.0,
        47.0,
        53.0,
        49.3,
        50.1,
        47.0,
        51.0,
        50.1,
        51.2,
        50.5,
        49.6,
        47.6,
        49.9,
        51.3,
        47.8,
        51.2,
        52.6,
        52.4,
        53.6,
        52.1,
    ]
)
NIST_EWMA = np.array(
    [
        50.60,
        49.52,
        50.56,
        50.18,
        50.16,
        49.21,
        49.75,
        49.85,
        50.26,
        50.33,
        50.11,
        49.36,
        49.52,
        50.05,
        49.38,
        49.92,
        50.73,
        51.23,
        51.94,
        51.99,
    ]
)

# D. C. Montgomery, Introduction to Statistical Quality Control, table 9.1:
# target 10, sigma 1; the last ten have a mean of 11
MONTGOMERY_SHIFT = np.array(
    [
        9.45,
        7.99,
        9.29,
        11.66,
        12.16,
        10.18,
        8.04,
        11.46,
        9.20,
        10.34,
        9.03,
        11.47,
        10.51,
        9.40,
        10.08,
        9.37,
        10.62,
        10.31,
        8.52,
        10.84,
        10.90,
        9.33,
        12.29,
        11.50,
        10.60,
        11.08,
        10.38,
        11.62,
        11.31,
        10.52,
    ]
)

# AIAG, Measurement Systems Analysis, 4th edition, III-B: ten parts, three appraisers, three trials
# (appraiser, trial, part)
AIAG_GAUGE = np.array(
    [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ]
)

# D. C. Montgomery, Design and Analysis of Experiments, 8th edition, table 13.1:
# twenty parts (rows), three operators, two measurements each
MONTGOMERY_GAUGE = np.array(
    [
        [21, 20, 20, 20, 19, 21],
        [24, 23, 24, 24, 23, 24],
        [20, 21, 19, 21, 20, 22],
        [27, 27, 28, 26, 27, 28],
        [19, 18, 19, 18, 18, 21],
        [23, 21, 24, 21, 23, 22],
        [22, 21, 22, 24, 22, 20],
        [19, 17, 18, 20, 19, 18],
        [24, 23, 25, 23, 24, 24],
        [25, 23, 26, 25, 24, 25],
        [21, 20, 20, 20, 21, 20],
        [18, 19, 17, 19, 18, 19],
        [23, 25, 25, 25, 25, 25],
        [24, 24, 23, 25, 24, 25],
        [29, 30, 30, 28, 31, 30],
        [26, 26, 25, 26, 25, 27],
        [20, 20, 19, 20, 20, 20],
        [19, 21, 19, 19, 21, 23],
        [25, 26, 25, 24, 25, 25],
        [19, 19, 18, 17, 19, 17],
    ],
    dtype=float,
).reshape(20, 3, 2)

# AIAG MSA: fifteen measurements of a part of 6.00
AIAG_BIAS = np.array([5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1, 6.2, 5.6, 6.0])

# AIAG MSA: five parts of 2, 4, 6, 8 and 10, twelve times each
AIAG_LINEARITY = {
    2.0: [2.7, 2.5, 2.4, 2.5, 2.7, 2.3, 2.5, 2.5, 2.4, 2.4, 2.6, 2.4],
    4.0: [5.1, 3.9, 4.2, 5.0, 3.8, 3.9, 3.9, 3.9, 3.9, 4.0, 4.1, 3.8],
    6.0: [5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1],
    8.0: [7.6, 7.7, 7.8, 7.7, 7.8, 7.8, 7.8, 7.7, 7.8, 7.5, 7.6, 7.7],
    10.0: [9.1, 9.3, 9.5, 9.3, 9.4, 9.5, 9.5, 9.5, 9.6, 9.2, 9.3, 9.4],
}


@pytest.fixture(scope="session")
def published():
    """All data sets by name."""
    return SimpleNamespace(
        nist_flowrate=NIST_FLOWRATE,
        nist_ewma_values=NIST_EWMA_VALUES,
        nist_ewma=NIST_EWMA,
        montgomery_shift=MONTGOMERY_SHIFT,
        aiag_gauge=AIAG_GAUGE,
        montgomery_gauge=MONTGOMERY_GAUGE,
        aiag_bias=AIAG_BIAS,
        aiag_linearity=AIAG_LINEARITY,
    )
