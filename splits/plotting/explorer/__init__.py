"""A page to play with: tables in one file of HTML, read between nodes as Python reads them."""
