"""Studies of designs: which factor matters, and how many units pass."""
