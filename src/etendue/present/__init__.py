"""What people see: one renderer, tables, plots, the page, the terminal."""
