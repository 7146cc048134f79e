"""The tables and figures of the pages, made of kept runs. Each module has `files`, the texts that `redraw` writes."""
