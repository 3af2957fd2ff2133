"""What people see: pictures, tables, plots, the page, the terminal."""
