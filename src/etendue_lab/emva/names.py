"""Displayed names of the EMVA 1288 metrics."""

NAMES = {
    "gain": "system gain K",
    "read_noise": "read noise",
    "dark_current": "dark current",
    "full_well": "full well",
    "dsnu": "DSNU1288",
    "prnu": "PRNU1288",
    "linearity_error": "linearity error",
    "saturation_capacity": "saturation capacity",
    "absolute_sensitivity": "sensitivity limit",
    "dynamic_range": "dynamic range",
    "snr_max": "SNR max",
    "quantum_efficiency": "quantum efficiency",
}
PERCENT = ("prnu", "linearity_error", "quantum_efficiency")
