"""The display's stages: white stays white in every space, cones and codes lead back to the light they came from."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue_camera import spectra
from etendue_camera.colour import matrices
from etendue_camera.colour.stages.display import (
    Decode,
    Display,
    Encode,
    FromCones,
    ToCones,
    ToXyz,
    primaries_to_cones,
    space_to_xyz,
)
from etendue_camera.colour.stages.display_white import MEASURED, white_of
from etendue_camera.colour.stages.tristimulus import Balance

SPACES = ("sRGB", "Adobe RGB (1998)", "ITU-R BT.2020", "Display P3", "ProPhoto RGB", *MEASURED)


def planes(seed=1, low=-0.2, high=1.2):
    return np.random.default_rng(seed).uniform(low, high, (3, 5, 7))


def through(stage, planes):
    prepared = {"prepared": stage.prepare({})} if hasattr(stage, "prepare") else {}
    (array,) = [a for name, a in stage.run(planes, **prepared).items() if name != "gamut_clipped"]
    return array


@pytest.mark.parametrize("name", SPACES)
def test_the_white_of_a_display_is_one_in_all_its_primaries(name):
    """To rounding of a 3 x 3 inverse, condition below 10."""
    white = np.broadcast_to(white_of(name)[:, None, None], (3, 2, 2))
    assert_allclose(through(Display(display=name), white), 1, atol=5e-15)


@pytest.mark.parametrize("name", SPACES)
def test_primaries_to_cones_and_back_is_the_identity(name):
    there = through(ToCones(display=name), planes())
    assert_allclose(through(FromCones(display=name), there), planes(), atol=2e-14)  # condition about 30
    assert_allclose(through(ToCones(display=name), np.ones((3, 1, 1))), 1, rtol=1e-15)


@pytest.mark.parametrize("name", MEASURED)
def test_cones_are_excited_by_what_the_primaries_send_out(name):
    """Section 3.2 of the paper, by hand: the sum over wavelength of fundamental times primary."""
    edges = tuple(float(w) for w in range(380, 785, 5))
    by_hand = np.einsum("wc,wp->cp", spectra.cone_fundamentals(edges), spectra.display_primaries(name, edges))
    assert_allclose(primaries_to_cones(name), by_hand / by_hand.sum(axis=1)[:, None], rtol=1e-14)


@pytest.mark.parametrize("name", ["sRGB", "Adobe RGB (1998)", "Display P3", "ITU-R BT.470 - 625", "DCDM XYZ"])
def test_to_xyz_undoes_the_display_of_the_same_space(name):
    shown = through(Display(display=name), planes())
    assert_allclose(through(ToXyz(matrix=name), shown), planes(), atol=1e-14)


def test_equation_16_is_the_ebu_space_of_the_library():
    assert_allclose(
        through(ToXyz(matrix="ebu"), planes()), through(ToXyz(matrix="ITU-R BT.470 - 625"), planes()), atol=1e-15
    )
    assert_allclose(
        through(ToXyz(matrix="eq16_as_printed"), np.ones((3, 1, 1))).ravel()[2], 1.298, atol=1e-12
    )  # the misprint's blue


@pytest.mark.parametrize("name", sorted(spectra.rgb_space_names()))
def test_every_rgb_space_has_a_matrix_that_keeps_its_white(name):
    """Computed from primaries and white; the library's, which has the digits its standard prints, differs by 6e-4 at
    most.
    """
    assert_allclose(space_to_xyz(name) @ np.ones(3), white_of(name), atol=6e-4)
    assert_allclose(space_to_xyz(name), spectra.rgb_space_matrix(name)[0], atol=6e-4)


@pytest.mark.long
def test_the_names_of_the_rgb_spaces_are_those_of_the_library():
    import colour as library

    assert spectra.rgb_space_names() == frozenset(library.RGB_COLOURSPACES.keys())


@pytest.mark.parametrize("stage", [Display, ToCones, FromCones])
def test_a_misspelt_display_is_refused_with_the_nearest_names(stage):
    with pytest.raises(ValueError, match=r"unknown RGB space 'Apple Studio'.*Apple Studio Display"):
        stage(display="Apple Studio")


def test_a_balance_may_aim_at_the_white_of_an_rgb_space():
    """ProPhoto's white is D50: equal to aiming at the illuminant, to the digits of the standard's chromaticity."""
    xyz, white = planes(), white_of("A")
    of_space = Balance(target="ProPhoto RGB")
    of_light = Balance(target="D50")
    one, other = (s.run(xyz, white, s.prepare({}))["xyz_scene"] for s in (of_space, of_light))
    assert_allclose(one, other, atol=1e-3)  # 6e-4: units of the fourth digit of a chromaticity
    with pytest.raises(ValueError, match="D55"):
        Balance(target="D56")


@pytest.mark.parametrize(
    "encoding",
    [{"encoding": "sRGB"}, {"encoding": "BT.709"}, {"encoding": "power"}, {"encoding": "power", "exponent": 0.2}],
)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_decoding_gives_back_the_light_that_the_display_could_show(encoding, kind):
    """sRGB's two branches meet to 2e-9 only; BT.709's leave a step of 2.5e-4 of code, 5e-5 of light."""
    light = planes().astype(kind)
    back = Decode(**encoding).run(Encode(**encoding).run(light)["rgb_display"])["rgb_linear"]
    assert back.dtype == kind
    assert_allclose(
        back, np.clip(light, 0, 1), atol={"BT.709": 6e-5}.get(encoding["encoding"], 4e-9) + 50 * np.finfo(kind).eps
    )


@pytest.mark.parametrize("exponent", [0.2, 0.45, 1.0, 3.0])
@pytest.mark.parametrize("encoding", ["sRGB", "BT.709", "power"])
def test_decoding_states_what_a_millionth_of_a_code_becomes_where_the_curve_is_steep(encoding, exponent):
    stage = Decode(encoding=encoding, exponent=exponent)
    codes = np.linspace(0.3, 1.0, 701)
    one, other = (stage.run(codes - away)["rgb_linear"] for away in (0.0, 1e-6))
    stated, how = stage.error({}, {}, "float32")
    assert how == "measured" and np.abs(one - other).max() <= stated * (1 + 1e-5)


def test_colours_are_named_by_their_state_so_that_codes_cannot_be_taken_for_light():
    for stage in (Display, ToCones, FromCones, ToXyz, Decode, Encode):
        for port in stage.reads:
            assert (port == "rgb_display") == (stage is Decode), stage


def test_the_misprinted_matrix_is_blue_and_the_corrected_one_is_not():
    assert_allclose(matrices.EQ16_CORRECTED @ np.ones(3), white_of("sRGB"), atol=1e-3)
    assert abs((matrices.EQ16_AS_PRINTED @ np.ones(3))[2] - white_of("sRGB")[2]) > 0.2


@pytest.mark.parametrize("away", [0.0, 1e-7, -1e-7])
def test_white_that_is_clipped_up_to_rounding_is_within_the_range(away):
    """A saturated frame stands at 1 on either side of the last bits; a hundredth beyond is counted."""
    frame = np.full((3, 4, 4), 1.0 + away)
    assert Encode().run(frame)["gamut_clipped"] == 0
    frame[0, 0, 0], frame[1, 0, 0] = 1.01, -0.01
    assert Encode().run(frame)["gamut_clipped"] == pytest.approx(2 / 48)
