"""The live view: a page in the browser, and what feeds it."""
