"""Laws of the C core: those of every device, and that it does what its Python twin does."""
