"""Look into a store: pictures, statistics, findings, one page of HTML, and a server for it."""
