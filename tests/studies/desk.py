"""Small synthetic measurements: flat fields and dark frames of a sensor with known parameters."""

import numpy as np

TRUE = {
    "gain": 0.25,
    "quantum_efficiency": 0.5,
    "read_noise": 8.0,
    "dsnu": 3.0,
    "prnu": 0.01,
    "black_level": 100.0,
    "dark_current": 2000.0,
}
TOP = 4095


def sensor(seed=0, size=64, bend=0.0, order=3, **own):
    """Return a function that takes frames: (time in s, photons, number of frames) to codes (frame, y, x)."""
    is_ = {**TRUE, "row_noise": 0.0, "column_noise": 0.0, "row_pattern": 0.0, "column_pattern": 0.0, **own}
    rng = np.random.default_rng(seed)
    offset, response = (
        is_["dsnu"] * rng.standard_normal((size, size)),
        1 + is_["prnu"] * rng.standard_normal((size, size)),
    )
    leak = 1 + is_.get("dark_nonuniformity", 0.0) * rng.standard_normal((size, size))
    offset = (
        offset + is_["row_pattern"] * rng.standard_normal((size, 1)) + is_["column_pattern"] * rng.standard_normal(size)
    )

    def take(time, photons, frames=2):
        mean = is_["quantum_efficiency"] * photons * response + is_["dark_current"] * time * leak
        charge = rng.poisson(mean, (frames, size, size)) + is_["read_noise"] * rng.standard_normal((frames, size, size))
        charge = charge + is_["row_noise"] * rng.standard_normal((frames, size, 1)) + offset
        charge = charge + is_["column_noise"] * rng.standard_normal((frames, 1, size))
        full = TOP / is_["gain"]
        charge = charge * (1 - bend * (np.maximum(charge, 0) / full) ** order)
        return np.clip(np.floor(charge * is_["gain"] + is_["black_level"] + 0.5), 0, TOP).astype(np.uint16)

    return take


def measurement(seed=0, levels=16, stack=8, **own):
    """Return the arrays of a measurement by time at constant light, up to beyond saturation."""
    take = sensor(seed, **own)
    times = np.linspace(0.001, 0.02, levels)
    photons = times / times[-1] * 1.15 * (TOP - TRUE["black_level"]) / own.get("gain", TRUE["gain"]) / 0.5
    half = levels // 2 - 1
    return {
        "light": np.stack([take(t, p) for t, p in zip(times, photons, strict=True)]),
        "light_time_s": times,
        "light_photons_per_pixel": photons,
        "dark": np.stack([take(t, 0) for t in times]),
        "dark_time_s": times,
        "light_stack": take(times[half], photons[half], stack),
        "light_stack_time_s": times[half],
        "light_stack_photons_per_pixel": photons[half],
        "dark_stack": take(times[half], 0, stack),
        "dark_stack_time_s": times[half],
    }


SIGMAS = 2.2  # half intervals of 95 %: 4.3 standard errors, one in 50,000


def beyond(model, true):
    """The parameters that lie further from the truth than 4.3 standard errors."""
    far = {}
    for name, value in true.items():
        one = model.values[name]
        if not one.value - SIGMAS * (one.value - one.low) <= value <= one.value + SIGMAS * (one.high - one.value):
            far[name] = (one, value)
    return far
