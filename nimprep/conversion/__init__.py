"""From a data set to a store.

What happens in ``nimprep convert`` is read in this order: ``cli/convert.py`` takes the command;
``run.py`` here plans, encodes and finishes; ``plan.py`` decides what will be written,
``workspace.py`` where, and how it gets its name; ``journal.py`` keeps what is done, ``encode.py``
makes frames, units and shards, ``records.py`` says what is kept of them and makes the tables, and
``store/writer.py`` writes. The other files are for what not every conversion has: gaps of skipped
frames, object stores, clusters, and stores that grow or are joined.
"""
