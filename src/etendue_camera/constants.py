"""Physical constants, exact in the SI of 2019, and the conversions that follow from them."""

ELEMENTARY_CHARGE = 1.602176634e-19  # C
PLANCK = 6.62607015e-34  # J s
SPEED_OF_LIGHT = 299792458.0  # m s-1
BOLTZMANN = 1.380649e-23  # J K-1
LUMINOUS_EFFICACY = 683.002  # lm W-1 at the peak of V(lambda), CIE 15:2018
ARCSECONDS_PER_RADIAN = 206264.80624709636
