"""Names of cameras and lenses as people type them."""

import pytest

from etendue.errors import RequestError
from etendue_camera.cameras.names import full_name, matching, meant, plain

NAMES = ["Nikon D800", "Nikon D800E", "Sony ILCE-7RM2", "Canon EOS R5", "Canon EOS R5m2", "Canon EOS 5D Mark II"]


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        ("sony ilce-7rm2", "Sony ILCE-7RM2"),
        ("SONY  ILCE 7RM2", "Sony ILCE-7RM2"),
        ("7rm2", "Sony ILCE-7RM2"),
        ("Sony a7R II", "Sony ILCE-7RM2"),
        ("α7r ii", "Sony ILCE-7RM2"),
        ("d800", "Nikon D800"),
        ("D800E", "Nikon D800E"),
        ("canon eos r5 mark ii", "Canon EOS R5m2"),
        ("eos 5d mark 2", "Canon EOS 5D Mark II"),
        ("5D MkII", "Canon EOS 5D Mark II"),
    ],
)
def test_a_name_is_found_as_people_type_it(typed, name):
    assert meant(typed, NAMES, "body", "etendue cameras") == name


def test_one_of_several_is_not_guessed_and_the_nearest_is_offered():
    with pytest.raises(RequestError, match="may be 'Canon EOS"):
        meant("canon", NAMES, "body", "etendue cameras")
    with pytest.raises(RequestError, match=r"did you mean 'Sony ILCE-7RM2'\?; etendue cameras lists them"):
        meant("Sony ILCE-7RN2", NAMES, "body", "etendue cameras")


def test_a_maker_stands_once_in_a_name():
    assert full_name("NIKON CORPORATION", "NIKON D810") == "Nikon D810"
    assert full_name("Sony", "FE 50mm f/1.8") == "Sony FE 50mm f/1.8"
    assert plain("Canon EOS R5 Mark II") == plain("canon EOS-R5m2")


def test_a_search_takes_words_in_any_order():
    assert matching("mark canon", NAMES) == ["Canon EOS 5D Mark II"]
