# Not built yet.
# docker build -t anisoscope .
# docker run --rm -v "$PWD:/work" anisoscope demo
# A rig: add --device /dev/ttyUSB0 --device /dev/video0
FROM python:3.11-slim-bookworm
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends libegl1 libgl1 libxrender1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY requirements.lock pyproject.toml setup.py README.md LICENSE ./
RUN pip install --no-cache-dir --no-compile -r requirements.lock
COPY inspect inspect
COPY rig rig
COPY profiles profiles
COPY sim sim
RUN pip install --no-cache-dir --no-deps . && useradd --create-home operator
USER operator
ENV NUMBA_CACHE_DIR=/home/operator/.cache/kernels
RUN anisoscope warm
WORKDIR /work
ENTRYPOINT ["anisoscope"]
CMD ["--help"]
