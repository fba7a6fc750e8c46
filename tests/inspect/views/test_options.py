"""Options of parameter models: every field can be stated, in every command that takes the model."""

import inspect
from dataclasses import dataclass, fields, replace

import pytest
from cyclopts import App, Group

from anisoscope.base.errors import ModelError, UsageError
from anisoscope.parameters.fabrication import Fabrication, HologramSearch
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.inputs import InputUncertainty
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.manufacture import Manufacture
from anisoscope.parameters.material import Material
from anisoscope.parameters.microscope import Microscope
from anisoscope.parameters.optics import Optics
from anisoscope.parameters.proof import ProofView
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.taking import Taking
from anisoscope.views.options import Given, Options, options_class, plain, with_options

MODELS = (
    *(Convention, Fabrication, InputUncertainty, Manufacture, Material, Microscope, Optics, ProofView),
    HologramSearch,
    RidgeDesign,
    Taking,
)


@dataclass(frozen=True)
class Slit:
    """A slit.

    Attributes:
        width_um: between its edges, µm.
        form: of its edges.
        tilt_deg: angle; none where it is left out.
        ends: left and right.
        round: whether it ends in arcs.

    Raises:
        ModelError: no width.
    """

    width_um: float = 5.0
    form: str = "sharp"
    tilt_deg: float | None = None
    ends: tuple[float, float] = (0.0, 1.0)
    round: bool = False

    def __post_init__(self):
        if not self.width_um > 0.0:
            raise ModelError(f"a slit needs a width, not {self.width_um:g}")


def program(**changes):
    app = App(name="slit", result_action="return_value")

    @app.default
    @with_options(slit=replace(Options(Slit, Group("Slit")), **changes))
    def command(*, slit: Given[Slit]):
        return slit

    return app


def given(*words, **changes):
    return program(**changes)(words, exit_on_error=False, print_error=False)


def test_options_are_the_fields_without_their_units(capsys):
    assert plain("pitch_um") == "--pitch"
    assert plain("u_alpha_share") == "--u-alpha"
    program()(["--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "--width FLOAT Between its edges, µm. [default: 5.0]" in shown
    assert "--ends FLOAT FLOAT Left and right. [default: 0,1]" in shown
    assert "--round --no-round" in shown


def test_what_is_given_stands_over_the_base():
    assert given().over(Slit(7.0)) == Slit(7.0)
    slit = given("--width", "0.02 mm", "--tilt", "3", "--ends", "1,2", "--round")
    assert slit.values == {"width_um": 20.0, "tilt_deg": 3.0, "ends": (1.0, 2.0), "round": True}
    assert slit.over(Slit(7.0, "blunt")) == Slit(20.0, "blunt", 3.0, (1.0, 2.0), True)
    assert given("--width", "5").over(Slit(7.0)) == Slit(5.0)  # the default too, where it is stated
    assert "width_um" in given("--width", "5")
    assert "width_um" not in given()


def test_the_option_out_of_its_range_is_named():
    with pytest.raises(UsageError, match=r"^--width: a slit needs a width, not -1$"):
        given("--width=-1", "--tilt", "3").over(Slit())
    with pytest.raises(UsageError, match=r"^--ends takes 2 numbers separated by commas, not '1'$"):
        given("--ends", "1")
    with pytest.raises(UsageError, match=r"^--form belongs to other slits$"):
        given("--form", "blunt").refuse(["tilt_deg", "form"], "belongs to other slits")


def test_a_whole_model_has_its_defaults_and_reads_its_lists():
    assert given(whole=True).made() == Slit()
    assert given("--ends", "1,2.5", whole=True).made() == Slit(ends=(1.0, 2.5))
    with pytest.raises(UsageError, match=r"^--ends takes 2 numbers separated by commas, not '1'$"):
        given("--ends", "1", whole=True).made()


@by_keywords(slit=Slit)
def open_wide(name, *, slit, times=2):
    return name, slit.width_um * times


def test_an_operation_takes_its_model_or_the_fields_as_keywords():
    assert open_wide("a") == ("a", 10.0)
    assert open_wide("a", slit=Slit(7.0), times=1) == ("a", 7.0)
    assert open_wide("a", width_um=3.0, times=1) == ("a", 3.0)
    with pytest.raises(ModelError, match="needs a width"):
        open_wide("a", width_um=0.0)
    with pytest.raises(TypeError, match="height"):
        open_wide("a", height=0.0)
    known = inspect.signature(open_wide).parameters
    assert list(known) == ["name", "times", "width_um", "form", "tilt_deg", "ends", "round"]
    assert known["width_um"].default == 5.0


def test_a_command_may_rename_reword_and_leave_out(capsys):
    changes = {
        "names": {"width_um": "--gap"},
        "prefix": "u-",
        "help": {"tilt_deg": "How it leans."},
        "default": Slit(9.0),
        "without": {"round": "always"},
        "readers": {"ends": lambda text, option: (float(text), 0.0)},
    }
    assert given("--gap", "2", "--u-ends", "4", **changes).over(Slit()) == Slit(2.0, ends=(4.0, 0.0))
    program(**changes)(["--help"])
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[default: 9.0]" in shown
    assert "How it leans." in shown
    assert "round" not in shown


def commands_with_models(guard):
    for words, app in guard.commands():
        models = getattr(app.default_command, "options_of_models", {})
        if models:
            yield words, app, models


def test_every_field_of_a_model_is_an_option_or_left_out_with_a_reason(guard):
    taken = set()
    for words, app, models in commands_with_models(guard):
        names = {name for one in app.assemble_argument_collection() for name in one.names}
        for options in models.values():
            taken |= set() if options.whole else {options.model}  # a whole one is that of one operation
            for one in fields(options.model):
                reason = options.without.get(one.name)
                assert options.option(one.name) in names or reason, f"{words}: {one.name} cannot be stated"
            unknown = set(options.without) - {one.name for one in fields(options.model)}
            assert not unknown, f"{words} leaves {unknown} out, which {options.model.__name__} does not have"
    assert taken <= set(MODELS)


BEGINNING = "a recipe to begin with asks for pitch and angle; the file states the rest"
OTHER_THINGS = {
    ("init", RidgeDesign): BEGINNING,
    ("recipe new", RidgeDesign): BEGINNING,
    (
        "rig commission",
        RidgeDesign,
    ): "what is known of the part on the stage; the recipe's where it is left out",
    ("rig commission", InputUncertainty): "of that part, whose other inputs are sought",
    ("profile texture", InputUncertainty): "of heights that are measured: other defaults, and no prediction",
    ("profile make", Material): "roughness that is made as heights: 0 by default, which no lobe has",
    ("design picture", HologramSearch): "of a mixture of steps, whose lamp is that of its fabrication",
    ("design depths", HologramSearch): "no unit is searched; the seed is that of another search",
}
"""Commands with options that only have the names of a model's fields, and why they are none of its."""


def test_no_command_declares_the_fields_of_a_model_by_hand(guard):
    found = set()
    for words, app in guard.commands():
        models = {options.model for options in getattr(app.default_command, "options_of_models", {}).values()}
        names = {name for one in app.assemble_argument_collection() for name in one.names}
        for model in set(MODELS) - {Taking}:  # every photograph has an exposure and a gain
            prefix = "--u-" if model is InputUncertainty else "--"
            like = {plain(one.name).replace("--", prefix, 1) for one in fields(model)} & names
            if len(like) > 1 and model not in models:
                found.add((words, model))
    assert found == set(OTHER_THINGS), "take the fields from the model, or say why they are none of its"


@dataclass(frozen=True)
class Hiding:
    """A model with a name that options have themselves.

    Attributes:
        option: of a camera.
        values: of a table.
    """

    option: str = ""
    values: str = ""


def test_a_field_that_would_hide_what_options_are_is_refused():
    with pytest.raises(TypeError, match=r"Hiding: rename the fields \['option', 'values'\]"):
        options_class(Options(Hiding))
    assert options_class(Options(Hiding, whole=True, without={"option": "of the test"})).lists == {}
