"""Published data sets, with their sources."""

from types import SimpleNamespace

import numpy as np
import pytest


def numbers(text):
    """Numbers of a table as they are printed."""
    return np.array(text.split(), dtype=float)


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

# AIAG, Measurement Systems Analysis, 4th edition, III-C: fifty parts, three appraisers, three trials; the parts on
# which decisions differ (A, B and C, three trials each; reference), and those on which all agree; reference values
AIAG_DIFFERING = {
    6: ("110110100", 1),
    7: ("111111101", 1),
    12: ("000000010", 0),
    14: ("110111100", 1),
    21: ("110101010", 1),
    22: ("001010110", 0),
    26: ("010000001", 0),
    30: ("000001000", 0),
    34: ("001001011", 0),
    36: ("110111101", 1),
    43: ("101111110", 1),
}
AIAG_BAD = (3, 4, 5, 9, 25, 37, 39, 42, 45, 48, 50)
AIAG_VALUES = """
.476901 .509015 .576459 .566152 .570360 .544951 .465454 .502295 .437817 .515573 .488905 .559918 .542704 .454518 .517377
.531939 .519694 .484167 .520496 .477236 .452310 .545604 .529065 .514192 .599581 .547204 .502436 .521642 .523754 .561457
.503091 .505850 .487613 .449696 .498698 .543077 .409238 .488184 .427687 .501132 .513779 .566575 .462410 .470832 .412453
.493441 .486379 .587893 .483803 .446697
"""


def aiag_attribute():
    """Decisions (part, appraiser, trial), reference and reference values."""
    rows = [
        AIAG_DIFFERING.get(part, ("000000000", 0) if part in AIAG_BAD else ("111111111", 1))
        for part in range(1, 51)
    ]
    decisions = np.array([[int(one) for one in text] for text, _ in rows]).reshape(50, 3, 3)
    return decisions, np.array([known for _, known in rows]), numbers(AIAG_VALUES)


# ISO 22514-7:2012, tables A.1 (ten standards, four readings) and A.4 (three operators, ten parts, three trials)
ISO_STANDARDS = {
    6.19: [6.31, 6.27, 6.31, 6.28],
    9.17: [9.27, 9.21, 9.34, 9.23],
    1.99: [2.21, 2.19, 2.22, 2.20],
    7.77: [8.00, 7.81, 7.95, 7.84],
    4.00: [4.27, 4.15, 4.15, 4.15],
    10.77: [10.93, 10.73, 10.92, 10.89],
    4.78: [4.95, 4.87, 5.00, 5.00],
    2.99: [3.24, 3.17, 3.21, 3.21],
    6.98: [7.14, 7.07, 7.18, 7.20],
    9.98: [10.23, 10.02, 10.07, 10.17],
}
ISO_PARTS = numbers(
    """
    8.120 8.435 8.480 7.445 6.815 7.490 9.965 10.010 9.560 6.140 5.960 6.365 5.690 5.600 5.780
    2.855 2.450 2.585 10.685 10.595 10.775 6.725 6.275 6.545 4.970 5.105 5.510 9.875 10.100 9.875
    8.200 8.290 8.245 7.300 7.120 7.075 9.660 9.340 9.250 6.095 6.185 6.185 5.080 5.340 5.440
    2.315 2.585 2.315 10.450 10.840 11.050 6.240 6.120 6.300 5.015 5.285 5.150 10.080 9.800 9.970
    8.525 8.435 8.345 7.535 7.355 7.085 9.830 9.695 9.515 6.140 6.140 6.050 5.780 5.735 5.555
    2.630 2.360 2.585 10.865 11.000 11.180 6.590 6.500 6.725 5.060 5.195 5.105 10.190 9.785 9.965
    """
).reshape(3, 10, 3)

# type-1 example of JASP's module for quality control (reference -4, tolerance 15)
JASP_TYPE_ONE = numbers(
    """
    -4 -4.1 -4.1 -4.1 -4.1 -3.9 -3.9 -3.9 -4.1 -4.2 -3.9 -4.2 -4 -3.8 -3.9 -3.9 -3.9 -3.9 -4.6 -4.3 -3.9 -3.7 -3.7 -3.9
    -4 -5 -3.9 -3.8 -3.7 -3.8 -3.7 -3.8 -3.6 -3.5 -3.6 -3.6 -3.4 -5.1 -3.5 -4 -4.5 -3.5 -5.1 -5 -3.5 -3.5 -3.5 -3.6 -3.6
    -3.5
    """
)

# MIL-HDBK-1823A, example 3 (hit/miss): lengths of found and of missed cracks in 0.001 inch
MIL_FOUND = numbers(
    """
    210 195 95 207 141 324 80 325 180 176 152 85 116 90 138 317 345 250 407 355 300 320 320 111 152 157 185 110 180
    145 165 150 144 260 315 300 250 200 320 352 45 213 167 215 190 182 187 235 235 216 195 187 235 262 205 227 207 188
    215 175 242 255 275 262 220 200 125 207 240 240 240 247 211 155 265 130 140 80 225 179 210 212 125 137 130 210 194
    202 212 257 216 210
    """
)
MIL_MISSED = numbers(
    """
    95 102 115 80 19 82 84 125 67 75 155 117 142 97 125 91 90 57 82 79 34 150 65 70 70 85 25 23 67 65 25 177 34 85 50
    70 75 80 87 50 182 125
    """
)
MIL_HIT_MISS = (
    np.concatenate([MIL_FOUND, MIL_MISSED]) / 1000.0,
    np.concatenate([np.ones(len(MIL_FOUND), dtype=bool), np.zeros(len(MIL_MISSED), dtype=bool)]),
)


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
        aiag_attribute=aiag_attribute(),
        mil_hit_miss=MIL_HIT_MISS,
        iso_standards=ISO_STANDARDS,
        iso_parts=ISO_PARTS,
        jasp_type_one=JASP_TYPE_ONE,
    )
