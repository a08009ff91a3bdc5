"""A data set in the formats that people train from: WebDataset, Parquet, Hugging Face, HDF5.

samples      reads lines and files of a data set, checked against their hashes
counts       how many lines there are of each kind, for the data card
folders      the folder of an export: parts that are written whole, so that the same command
             continues; the data card is written last
webdataset   tar files that the package `webdataset` decodes without code of ours
tables       Parquet files, plain or in the layout of Hugging Face's `datasets`
blenderproc  HDF5 files with the keys of BlenderProc's writer, and a reader of both programs' files
card         the data card: what, how many, rendered by what, licences, known limits
card_errors  its part on the error and the bias of pictures
"""

from typing import Literal, get_args

Format = Literal["webdataset", "parquet", "huggingface", "hdf5"]
FORMATS: tuple[Format, ...] = get_args(Format)
