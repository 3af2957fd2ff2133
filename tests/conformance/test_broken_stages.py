"""A stage that breaks its declaration is found out, by the law it breaks and in words that say how."""

import subprocess
import sys

import pytest

from etendue.contract.arrays.grid import Grid, Labels, Line
from etendue.testing import Finding, StageConformance, check_stage, laws
from tests.conformance import broken
from tests.conformance.faulty import geometry, noise, ranges, state, values

BROKEN = [
    (broken.Transposed, "test_it_writes_what_it_declares", "shape"),
    (broken.Undeclared, "test_it_writes_what_it_declares", "by_the_way"),
    (broken.Mutating, "test_inputs_are_left_alone", "writes into its input"),
    (broken.ForcedMutating, "test_inputs_are_left_alone", "writes into its input"),
    (broken.UndefinedInTheDark, "test_extremes_stay_finite_or_are_refused_clearly", "NaN"),
    (broken.CrashingOnOnePixel, "test_extremes_stay_finite_or_are_refused_clearly", "IndexError"),
    (
        broken.NumbersForLabels,
        "test_the_declaration_is_well_formed",
        r"Labels\(\(0.0, 45.0, 90.0, 135.0\)\), from etendue.api",
    ),
    (broken.SilentAboutBlack, "test_noise_about_black_is_met_with_a_word_of_its_own", "negative = 'keep' or 'clip'"),
    (broken.WarnsOfPorts, "test_its_notes_are_of_their_form", "not subscriptable"),
    (broken.FalseError, "test_the_stated_error_is_true_of_single_against_double_precision", "state the true error"),
    (broken.NonsenseError, "test_the_stated_error_is_true_of_single_against_double_precision", "guessed"),
    (broken.FalseGain, "test_errors_grow_by_no_more_than_the_gain", "but gain is 1"),
    (broken.FalseGainByPattern, "test_errors_grow_by_no_more_than_the_gain", "but gain is 1"),
    (broken.FalseRange, "test_carried_facts_are_true_of_what_is_written", "states a maximum of"),
    (broken.FalselyUniform, "test_carried_facts_are_true_of_what_is_written", "states uniform"),
    (broken.NotNegligible, "test_leaving_it_out_is_no_worse_than_negligible_says", "it is said to do little"),
    (broken.Greedy, "test_the_declaration_is_well_formed", r"\*arrays"),
    (broken.Curious, "test_the_declaration_is_well_formed", "weather"),
    (broken.WithoutCreates, "test_the_declaration_is_well_formed", "give the class creates"),
    (broken.ClipsNothing, "test_the_declaration_is_well_formed", "shrug"),
    (broken.NoValue, "test_it_is_a_value", "not hashable"),
    (broken.BareParameter, "test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range", "without param"),
    (
        broken.DefaultOutOfRange,
        "test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range",
        "default is refused",
    ),
    (
        broken.SettingOutOfRange,
        "test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range",
        "own setting 1 is refused",
    ),
    (broken.BackwardLadder, "test_a_finer_setting_states_no_larger_error", "cheaper 8"),
    (broken.OtherUnit, "test_every_parameter_has_a_unit_and_refuses_what_is_out_of_range", "in mm"),
    (
        broken.OtherUnitOfAVariable,
        "test_the_declaration_is_well_formed",
        "writes charge in DN, but the vocabulary has it in electron",
    ),
    (broken.Remembering, "test_bits_do_not_depend_on_repetition_company_or_thread", "different bits"),
    (broken.Unseeded, "test_bits_do_not_depend_on_repetition_company_or_thread", "different bits"),
    (broken.LetsUndefinedPass, "test_undefined_input_meets_the_declared_policy", "but fails on nan"),
    (broken.MovingGrid, "test_the_grid_is_a_pure_function", "another grid"),
    (broken.LosingLight, "test_a_transfer_function_keeps_the_mean_and_a_real_image_real", "loses light"),
    (broken.Amplifying, "test_a_transfer_function_keeps_the_mean_and_a_real_image_real", "amplify"),
    (broken.Lopsided, "test_a_transfer_function_keeps_the_mean_and_a_real_image_real", "conjugate"),
    (broken.SilentlyNegative, "test_negative_input_meets_the_declared_policy", "negative = 'keep'"),
    (broken.FalseSource, "test_carried_facts_are_true_of_what_is_written", "states uniform"),
    (broken.FalseContrast, "test_carried_facts_are_true_of_what_is_written", "states a contrast of 2"),
    (
        broken.WholeOnly,
        "test_bands_alone_are_the_bands_of_the_whole",
        "different values of irradiance by band than for all bands",
    ),
    (
        broken.SeesItsRows,
        "test_bands_alone_are_the_bands_of_the_whole",
        "different values of irradiance for some rows of a band than",
    ),
    (
        broken.ShortHalo,
        "test_rows_alone_are_the_rows_of_the_whole",
        "different bits of charge 1 rows at a time.* of the largest value: state the halo that it needs .def halo",
    ),
    (
        broken.BlindToItsWindow,
        "test_a_window_of_the_whole_is_read_where_it_stands",
        "from row 1, column 0 on, of even colours, differs by .* masks",
    ),
    (
        broken.BlindInPart,
        "test_a_window_of_the_whole_is_read_where_it_stands",
        "from row 0, column 1 on, of even colours, differs by .* masks",
    ),
    (
        broken.BandedFromItsWindow,
        "test_a_window_of_the_whole_is_read_where_it_stands",
        "from row 0, column 1 on, of a picture, differs by .* masks",
    ),
    (broken.FalseMean, "test_its_mean_is_that_of_its_draws", "but mean.. is"),
    (broken.DrawingMean, "test_its_mean_is_that_of_its_draws", "draws no random numbers"),
    (broken.FalseError, "test_digits_are_kept_in_every_precision", "digits lost in single precision"),
    (broken.Restless, "test_a_small_change_of_what_is_read_changes_little", "jumps by"),
    (broken.RestlessParameter, "test_a_small_change_of_a_parameter_changes_little", "strength = 1.1 moves by"),
    (broken.HiddenConstant, "test_the_unit_of_light_does_not_matter", "a hidden constant"),
    (broken.Upturned, "test_the_order_that_it_keeps_is_kept", "falls by"),
    (
        broken.Leaking,
        "test_the_sum_that_it_keeps_is_kept",
        "declares that it keeps the sum, but changes the sum of a point",
    ),
    (broken.LouderThanSaid, "test_the_noise_has_the_variance_that_it_says", "variance states 3 electron2"),
    (broken.NearlyLinear, "test_what_it_solves_costs_no_more_digits_than_its_condition", "cannot be recovered"),
    (broken.OtherShape, "test_it_writes_what_it_declares", "shape"),
    (geometry.PaddedWithZeros, "test_uniform_light_stays_uniform_to_the_rim", "lost or gained at the rim"),
    (geometry.BlursToTheRight, "test_mirrored_input_gives_the_mirrored_result", "mirrored left and right"),
    (geometry.EveryOtherColumn, "test_a_shifted_picture_gives_the_shifted_result", "depends on the place"),
    (broken.CountsInFewDigits, "test_the_far_corner_of_a_large_frame_is_like_the_near_one", "with too few digits"),
    (state.MeanOfTheFirstPicture, "test_nothing_of_one_picture_reaches_the_next", "affects the next"),
    (state.SharedBuffer, "test_two_threads_do_not_notice_each_other", "different bits"),
    (ranges.GainSwitches, "test_nothing_jumps_over_thirteen_decades_of_light", "charge jumps by"),
    (ranges.ParameterSwitches, "test_nothing_jumps_over_the_range_of_a_parameter", "where strength = 0.6"),
    (values.CutsDown, "test_codes_stand_in_the_middle_of_their_steps", "round to the nearest code"),
    (values.NeutralIsDimmer, "test_a_neutral_value_changes_nothing", "with amount = 0 it should leave charge alone"),
    (noise.MeanOff, "test_its_draws_are_those_that_it_declares", "standard errors from it"),
]


@pytest.fixture(autouse=True)
def _fresh():
    state.forget()


def conformance(stage):
    return type("Conformance", (StageConformance,), {"stage": stage})()


def test_the_sound_stage_has_no_finding():
    assert check_stage(broken.Sound()) == []


@pytest.mark.parametrize(("kind", "law", "words"), BROKEN, ids=[kind.__name__ for kind, _, _ in BROKEN])
def test_each_broken_stage_is_caught_by_the_law_it_breaks(kind, law, words):
    with pytest.raises(AssertionError, match=words):
        getattr(conformance(kind()), law)()
    assert law in {finding.law for finding in check_stage(kind())}


def test_a_stage_that_is_made_inside_a_function_cannot_travel():
    local = type("Local", (broken.Sound,), {"__module__": broken.__name__})
    with pytest.raises(AssertionError, match="cannot be sent to another process"):
        conformance(local()).test_it_is_a_value()


def test_dims_the_kit_does_not_know_get_three_labels_or_the_grid_that_is_given():
    assert check_stage(broken.MadeOfThree()) == []
    stack = Grid.of({"frame": Labels((0.0, 1.0)), "y": Line(5), "x": Line(3)})
    assert check_stage(broken.MadeOfThree(), grids={"stack": stack}, scales={"stack": 10.0}) == []


def test_what_is_no_coordinate_is_one_finding_in_words():
    """Not one for each law, of an attribute that a tuple has not."""
    (finding,) = check_stage(broken.NumbersForLabels())
    assert "size" not in str(finding)


def test_a_dim_of_a_fixed_size_is_taken_from_who_makes_it_or_is_said():
    """`NumbersForLabels` makes none that is a coordinate, so that it is asked for; with it the stage keeps every
    law.
    """
    assert "coordinates = {'polariser'" in str(check_stage(broken.ReadsFour())[0])
    angles = {"polariser": Labels((0.0, 45.0, 90.0, 135.0), "deg")}
    assert check_stage(broken.ReadsFour(), coordinates=angles) == []


def test_every_law_can_be_broken_by_one_of_these_stages():
    assert {law for _, law, _ in BROKEN} == set(laws())


def test_a_finding_reads_as_a_sentence():
    assert str(Finding("test_it_is_a_value", "it is none")) == "it is a value: it is none"


def test_the_kit_is_imported_without_pytest():
    code = "import sys; sys.modules['pytest'] = None; import etendue.testing; assert 'zarr' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
