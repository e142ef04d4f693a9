"""ON-LINE: touch in, command out."""
