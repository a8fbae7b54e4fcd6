"""The live view: a page in the browser, and what feeds it."""

LOOPBACK, PORT = "127.0.0.1", 8080  # where the page is served unless set otherwise
