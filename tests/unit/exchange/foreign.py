"""Files as other programs write them: MATLAB 7.3 by hand, after its own conventions."""

import h5py
import numpy as np

HEADER = (
    b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  6 10:00:00 2025 HDF5 schema "
)


class Matlab73:
    """A `.mat` file of version 7.3: arrays turned round, texts as UTF-16, cells by reference."""

    def __init__(self, path):
        self.path = path
        self.file = h5py.File(path, "w", userblock_size=512)
        self.references = self.file.create_group("#refs#")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.file.close()
        with self.path.open("r+b") as file:
            file.write(HEADER.ljust(124, b" ") + b"\x00\x02IM")

    def marked(self, parent, name, data, kind):
        dataset = parent.create_dataset(name, data=data)
        dataset.attrs["MATLAB_class"] = np.bytes_(kind)
        return dataset

    def struct(self, parent, name):
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        return group

    def numbers(self, parent, name, array):
        return self.marked(parent, name, np.asarray(array, dtype=np.float64).T, "double")

    def text(self, parent, name, text):
        units = np.frombuffer(text.encode("utf-16-le"), dtype=np.uint16)
        return self.marked(parent, name, units[:, None], "char")

    def cells(self, parent, name, texts):
        made = [self.text(self.references, f"{name}{i}", text).ref for i, text in enumerate(texts)]
        array = np.array([made], dtype=h5py.ref_dtype)
        return self.marked(parent, name, array, "cell")

    def struct_array(self, parent, name, field, arrays):
        """`name(i,j).field`, arrays a table of them."""
        group = self.struct(parent, name)
        table = np.empty((len(arrays[0]), len(arrays)), dtype=h5py.ref_dtype)
        for i, row in enumerate(arrays):
            for j, array in enumerate(row):
                made = self.numbers(self.references, f"{name}{field}{i}_{j}", array)
                table[j, i] = made.ref
        group.create_dataset(field, data=table, dtype=h5py.ref_dtype)
        return group
