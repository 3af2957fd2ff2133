"""Trust in archives: reproduce, compare and repair them."""
