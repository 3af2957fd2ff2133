"""The laws of place, one test method each.

In:  the bench of a stage.
Out: nothing, or a broken law: light lost at the rim, a picture moved by a fraction of a pixel, a border off by one.
"""

from __future__ import annotations

from etendue.testing.behaviour import geometry
from etendue.testing.bench import Bench


class PlaceLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench

    def test_uniform_light_stays_uniform_to_the_rim(self) -> None:
        """For a stage that gets positions, the result need not be uniform, but must not depend on the border of its
        input.
        """
        geometry.uniform_to_the_rim(self.bench)

    def test_mirrored_input_gives_the_mirrored_result(self) -> None:
        """The picture is mirrored up and down, left and right, unless the stage declares ``handed``."""
        geometry.mirror_images(self.bench)

    def test_a_shifted_picture_gives_the_shifted_result(self) -> None:
        """A shifted picture gives the shifted result; tested for stages that get no positions."""
        geometry.shifted_pictures(self.bench)

    def test_the_far_corner_of_a_large_frame_is_like_the_near_one(self) -> None:
        """The far corner of a frame of a hundred million places is computed like the near corner."""
        geometry.far_corner(self.bench)
