# The service in an image: see deploy/README.md. Build: docker build --tag orbitfb .
FROM python:3.11-slim-bookworm AS wheel
WORKDIR /source
COPY constraints.txt ./
RUN pip install --no-cache-dir --constraint constraints.txt hatchling
COPY pyproject.toml README.md LICENSE ./
COPY orbitfb orbitfb
RUN pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /wheels .

FROM python:3.11-slim-bookworm AS environment
COPY constraints.txt /tmp/constraints.txt
# torch without CUDA, in a layer of its own: it is the largest and changes least
RUN python -m venv /opt/orbitfb \
 && /opt/orbitfb/bin/pip install --no-cache-dir --constraint /tmp/constraints.txt \
    --index-url https://download.pytorch.org/whl/cpu torch
COPY --from=wheel /wheels /wheels
RUN /opt/orbitfb/bin/pip install --no-cache-dir --constraint /tmp/constraints.txt \
    "$(echo /wheels/orbitfb-*.whl)[web]"

FROM python:3.11-slim-bookworm
COPY --from=environment /opt/orbitfb /opt/orbitfb
COPY deploy/orbitfb.toml deploy/epics/access.toml /etc/orbitfb/
RUN useradd --system --uid 10001 --user-group --home-dir /var/lib/orbitfb orbitfb \
 && install --directory --owner orbitfb --group orbitfb --mode 0750 /var/lib/orbitfb \
 && install --directory --owner orbitfb --group orbitfb --mode 0700 /run/orbitfb
ENV PATH=/opt/orbitfb/bin:$PATH \
    ORBITFB_DATA_DIRECTORY=/var/lib/orbitfb \
    XDG_RUNTIME_DIR=/run/orbitfb \
    MPLCONFIGDIR=/tmp/matplotlib \
    OPENBLAS_NUM_THREADS=1 \
    OMP_NUM_THREADS=1
USER 10001:10001
WORKDIR /var/lib/orbitfb
VOLUME /var/lib/orbitfb
# alive, not ready: a loop that tripped waits for its operator and must not be restarted
HEALTHCHECK --interval=30s --timeout=30s --start-period=60s --retries=3 \
    CMD ["orbitfb", "health", "--config", "/etc/orbitfb/orbitfb.toml"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["orbitfb"]
CMD ["run", "--ioc", "sim", "--config", "/etc/orbitfb/orbitfb.toml"]
