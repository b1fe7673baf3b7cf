"""Copies a recording with the writer of the Python package `mcap`, which compresses:

    python3 tests/recording_compress.py run.mcap zstd run_zstd.mcap
"""

import sys

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

path, compression, copy = sys.argv[1:]
with open(path, "rb") as recorded, open(copy, "wb") as output:
    reader = make_reader(recorded)
    # Several chunks, so that a part of the copy is read by its index.
    writer = Writer(output, chunk_size=20_000, compression=CompressionType[compression.upper()])
    writer.start(profile="ros2")
    for metadata in reader.iter_metadata():
        writer.add_metadata(metadata.name, metadata.metadata)
    schemas, channels = {}, {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        if channel.id not in channels:
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
            )
        writer.add_message(
            channels[channel.id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
    writer.finish()
