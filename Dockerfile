# Not built yet. On Linux:
#   docker build -t anisoscope .       # devices of other makers: --build-arg EXTRAS=console,openid,line,basler,genicam
#   run() { docker run --rm -it --init --network host --user "$(id -u):$(id -g)" -e USER -v "$PWD:/work" -v anisoscope-home:/home/inspector "$@"; }
#   run anisoscope demo
# With a rig: its devices, and the groups that may open them (Debian's; elsewhere their numbers: stat -c %g /dev/ttyUSB0):
#   rig="--device /dev/ttyUSB0 --device /dev/video0 --device /dev/bus/usb --group-add dialout --group-add video --group-add plugdev"
#   run $rig anisoscope inspect --recipe plate.toml --rig rig.toml --serial A-0001
#   run $rig anisoscope serve --rig rig.toml --recipes recipes
#   run $rig anisoscope line opcua --rig rig.toml --recipes recipes
# What is written into /work belongs to you; keys, settings, cache and kernels stay in the volume. With the network of the
# host, addresses and ports are those of the docs: serve and line listen at 127.0.0.1 unless --host says otherwise. Stop
# a rig from outside by `docker exec CONTAINER anisoscope rig stop`: processes of other containers are not seen.
FROM python:3.11-slim-bookworm
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends \
    libegl1 libgl1 libxrender1 libgl1-mesa-dri libaravis-0.8-0 \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY requirements.lock requirements-dev.lock pyproject.toml setup.py README.md LICENSE ./
RUN pip install --no-cache-dir -r requirements.lock
COPY LICENSES LICENSES
COPY inspect inspect
COPY rig rig
COPY profiles profiles
COPY sim sim
ARG EXTRAS=console,openid,line
# extras in the versions that are tested; pip takes no folder where hashes are demanded
RUN sed -n 's/^\([a-zA-Z0-9].*==.*\) \\$/\1/p' requirements-dev.lock >tested.txt \
    && pip install --no-cache-dir -c tested.txt ".[view,formats,$EXTRAS]"
# Debian has a group "operator". Any user may run the image, and numba reads kernels only where it may write.
RUN useradd --uid 1000 --create-home --groups dialout,video,plugdev inspector
ENV HOME=/home/inspector USER=inspector NUMBA_CACHE_DIR=/home/inspector/.cache/kernels
USER inspector
RUN anisoscope warm && chmod -R a+rwX /home/inspector
WORKDIR /work
ENTRYPOINT ["anisoscope"]
CMD ["--help"]
