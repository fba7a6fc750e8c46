"""The defects of moulded ridges, each an object that an entry point of ``anisoscope.defects`` names."""

from dataclasses import replace

import numpy as np

from anisoscope.base.cause_words import SEAT_AGAIN, CauseWords
from anisoscope.base.errors import HeightMapError
from anisoscope.profiles import defects
from anisoscope.profiles.defect_injection import COMPUTED_RIDGES, Defect, Setting, Values
from anisoscope.profiles.defects_contact import dust, edge_wear, scratches
from anisoscope.profiles.defects_layout import ridge_layout
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness

ALONG_Y_DEG = 1.0
_TOOL = "and have the tool checked"
_MISSING = (1, 2, 4, 7, 10)
_ALONG_SHARE = 0.6


def _burrs(surface: HeightMap, values: Values, rng: np.random.Generator) -> HeightMap:
    period = ridge_layout(surface).period
    if abs(period.direction_deg) > ALONG_Y_DEG:
        raise HeightMapError(
            f"burrs are made on ridges along y; these run at {period.direction_deg:.3g}°. Turn the map first"
        )
    return defects.burrs(
        surface,
        values["coverage"],
        pitch_um=period.pitch_um,
        height_um=(values["least_height_um"], values["greatest_height_um"]),
        size_um=(values["least_length_um"], values["greatest_length_um"]),
        rng=rng,
    ).map


def _ridge_angle(surface: HeightMap, values: Values, _rng: np.random.Generator) -> HeightMap:
    layout = ridge_layout(surface)
    return defects.ridge_angle_error(
        surface, values["delta_deg"], ridge_angle_deg=layout.ridge_angle_deg, period=layout.period
    )


def _roughness(surface: HeightMap, values: Values, rng: np.random.Generator) -> HeightMap:
    alpha = values["alpha"]
    return add_facet_roughness(surface, alpha * values["along_share"], alpha, values["correlation_um"], rng)


BURRS = Defect(
    "burrs",
    "moulding: plastic in cracks of the tool, or torn on demoulding; tooling: chips left at edges",
    Setting("coverage", "", "share of the area that is covered", 0.2),
    (
        Setting("least_height_um", "µm", "least height of a burr", 2.0),
        Setting("greatest_height_um", "µm", "greatest height of a burr", 8.0),
        Setting("least_length_um", "µm", "least length along the ridge", 10.0),
        Setting("greatest_length_um", "µm", "greatest length along the ridge", 60.0),
    ),
    _burrs,
    title="burrs, share of the area",
    plain=CauseWords(
        "Burrs cover about {size} of the area",
        f"Reject or deburr the part {_TOOL} for chipped edges and cracks",
        region="burr",
    ),
    local=True,
    place=1,
)
WEAR = Defect(
    "wear",
    "use: crests rubbed off; moulding: crests that stuck to the tool. On a map of the tool: worn tool",
    Setting("radius_um", "µm", "radius of convex edges", 20.0),
    (),
    lambda surface, values, _: edge_wear(surface, values["radius_um"]),
    title="worn edges, radius",
    plain=CauseWords("Ridge edges are worn to a radius of about {size}", f"Reject the part {_TOOL} for wear"),
    doubt=0.15,  # Mitsuba's arcs change by 4 to 16 % less or more
    extruded=True,
    guessed=2.0,
    groove=lambda groove, radius_um, pitch_um: groove.worn(radius_um, pitch_um),
    # exact arcs: a ball that rolls along points leaves notches at some radii, which shine at 180°
    design=lambda design, radius_um: replace(design, edge_radius_um=max(radius_um, design.edge_radius_um)),
    place=2,
)
INCOMPLETE_FILLING = Defect(
    "incomplete-filling",
    "moulding: melt or tool too cold, packing pressure too low, trapped air, far from the gate",
    Setting("loss", "", "share of the ridge height that is missing", 0.6),
    (Setting("gradient", "", "growth of the loss along +y, −1 to 1", 0.0),),
    lambda surface, values, _: defects.incomplete_filling(
        surface, values["loss"], gradient=values["gradient"]
    ),
    title="incomplete filling, share of the ridge height that is missing",
    plain=CauseWords(
        "Ridges are not filled: about {size} of their height is missing",
        "Reject the part; raise melt or mould temperature or packing pressure, and clean the vents",
    ),
    doubt=0.03,  # a real crest differs from the model cut, and on rough facets the change by 2 to 3 % of itself
    extruded=True,
    guessed=1.0,
    groove=lambda groove, loss, _: groove.shortened(loss),
    place=3,
)
RIDGE_ANGLE = Defect(
    "ridge-angle",
    "tooling: cutter ground or set at a wrong angle; moulding: sagging, uneven shrinkage",
    Setting("delta_deg", "°", "change of the slope of the facets", 4.0),
    (),
    _ridge_angle,
    title="ridge angle, off by",
    plain=CauseWords(
        "Ridges are about {size} steeper than designed",
        f"{SEAT_AGAIN}: the angle of the ridges comes from the mould",
        "Ridges are about {size} flatter than designed",
    ),
    doubt=0.03,  # as that of the filling
    extruded=True,
    signed=True,
    turns_facets=True,
    groove=lambda groove, delta_deg, _: groove.turned_by(delta_deg),
    place=4,
)
PITCH = Defect(
    "pitch",
    "tooling: wrong feed, lead screw worn or warm; moulding: wrong allowance for shrinkage",
    Setting("error_percent", "%", "change of pitch and height, angles kept", 10.0),
    (),
    lambda surface, values, _: defects.pitch_error(surface, values["error_percent"]),
    title="pitch, off by",
    plain=CauseWords(
        "The pitch is about {size} too large",
        "Reject the part and check shrinkage and feed of the tool's machining",
        "The pitch is about {size} too small",
    ),
    doubt=1.0,  # which flanks are cut by the ends of the region is not known
    signed=True,
    scales_pitch=True,
    place=5,
)
ROUGH_FACETS = Defect(
    "rough-facets",
    "tooling: worn or chipped cutter, built-up edge, corroded or badly polished tool; moulding: cold tool",
    Setting("alpha", "", "Beckmann roughness across the ridges", 0.2),
    (
        Setting("along_share", "", "roughness along the ridges, as a share of that across", _ALONG_SHARE),
        Setting("correlation_um", "µm", "geometric mean of the correlation lengths", 8.0),
    ),
    _roughness,
    title="rough facets, added roughness across the ridges",
    plain=CauseWords(
        "Facets are rough: their roughness across the ridges is higher by about {size}",
        f"Reject the part {_TOOL}: polish, corrosion, built-up edge",
        percent=False,
    ),
    doubt=0.1,
    guessed=1.0,
    groove=lambda groove, alpha, _: groove.rougher(_ALONG_SHARE * alpha, alpha),
    place=6,
)
SCRATCHES = Defect(
    "scratches",
    "handling: parts rubbing, grippers, grit in cloth; moulding: drag marks of ejection",
    Setting("density_per_mm2", "1/mm²", "number of scratches", 60.0),
    (
        Setting("depth_um", "µm", "greatest depth below the crests", 4.0),
        Setting("width_um", "µm", "width at the crests", 12.0),
        Setting("length_um", "µm", "mean length", 400.0),
    ),
    lambda surface, values, rng: scratches(
        surface,
        values["density_per_mm2"],
        depth_um=values["depth_um"],
        width_um=values["width_um"],
        length_um=values["length_um"],
        rng=rng,
    ),
    title="scratches, number per area",
    plain=CauseWords(
        "The part is scratched: about {size}",
        "Reject the part; check grippers, packing and ejection",
        region="scratch",
    ),
    local=True,
    place=7,
)
DUST = Defect(
    "dust",
    "handling: dust, abrasion; moulding: residue of release agent, deposits from the tool",
    Setting("density_per_mm2", "1/mm²", "number of grains", 400.0),
    (Setting("diameter_um", "µm", "median diameter", 10.0),),
    lambda surface, values, rng: dust(
        surface, values["density_per_mm2"], diameter_um=values["diameter_um"], rng=rng
    ),
    title="dust, number of grains per area",
    plain=CauseWords(
        "Dust lies on the part: about {size}",
        "Blow the part clean and inspect it again; if it fails again, reject",
        region="dust",
    ),
    local=True,
    place=8,
)
MISSING_RIDGES = Defect(
    "missing-ridges",
    "moulding: clogged grooves of the tool; tooling: passes skipped, broken cutter",
    Setting("share", "", "share of the ridges that are missing", 0.4),
    (),
    lambda surface, values, rng: defects.missing_ridges(surface, values["share"], rng=rng),
    title="missing ridges, share",
    plain=CauseWords(
        "About {size} of the ridges are missing",
        f"Reject the part {_TOOL} for clogged grooves",
        region="missing ridge",
    ),
    doubt=0.2,  # which ones, and their length within the region
    local=True,
    computed=tuple(count / COMPUTED_RIDGES for count in _MISSING),
    place=9,
)
CHATTER = Defect(
    "chatter",
    "tooling: cutter, holder or spindle in resonance while the tool was cut",
    Setting("amplitude_um", "µm", "amplitude of the waves along the ridges", 2.0),
    (
        Setting("wavelength_um", "µm", "wavelength along the ridges", 80.0),
        Setting("phase_step", "", "shift from ridge to ridge, in wavelengths", 0.25),
        Setting("jitter", "", "standard deviation of that shift, in wavelengths", 0.1),
    ),
    lambda surface, values, rng: defects.chatter(
        surface,
        values["amplitude_um"],
        wavelength_um=values["wavelength_um"],
        phase_step=values["phase_step"],
        jitter=values["jitter"],
        rng=rng,
    ),
    title="chatter marks, amplitude",
    plain=CauseWords(
        "The facets bear chatter marks of about {size} amplitude",
        f"Reject the part {_TOOL}: the marks come from its machining",
    ),
    doubt=0.2,
    place=10,
)
