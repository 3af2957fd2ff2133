"""Transfer functions joined into one pass: one transform, products in frequency, one transform back."""
