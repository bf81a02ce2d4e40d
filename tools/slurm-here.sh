#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# A real Slurm on this machine alone, to try `mgf town --executor slurm`: one controller, one node with two slots, munge.
# It needs Debian's packages (apt install slurmctld slurmd slurm-client munge) and root, but no systemd. Slurm's commands
# look for /etc/slurm/slurm.conf, within jobs above all: that is a link into FOLDER until `stop`.
#
#   tools/slurm-here.sh start FOLDER       start all three
#   tools/slurm-here.sh kill-node FOLDER   kill the node's daemon and all that runs under it, as a power cut does
#   tools/slurm-here.sh start-node FOLDER  start it again
#   tools/slurm-here.sh stop FOLDER        cancel all jobs and stop all three by their pid files
#
# SLOTS (2) is the number of jobs side by side, SLURM_PORT (16817) the first of two free ports.
set -euo pipefail
export PATH=$PATH:/usr/sbin:/sbin

usage() { sed -n '3,12s/^# \{0,1\}//p' "$0" >&2; exit 2; }
[ $# = 2 ] || usage
action=$1
case $action in start | kill-node | start-node | stop) ;; *) usage ;; esac
mkdir -p "$2"
folder=$(cd "$2" && pwd)
conf=$folder/slurm.conf
link=/etc/slurm/slurm.conf

need() {
    for command in munged slurmctld slurmd sbatch; do
        command -v "$command" >/dev/null || {
            echo "slurm-here.sh: $command is not installed: apt install slurmctld slurmd slurm-client munge" >&2
            exit 2
        }
    done
}

configure() {
    local slots=${SLOTS:-2} port=${SLURM_PORT:-16817} user memory
    user=$(id -un)
    memory=$(awk '/MemTotal/ { print int(0.9 * $2 / 1024) }' /proc/meminfo)
    mkdir -p "$folder/state" "$folder/spool" "$folder/munge"
    chmod 700 "$folder/munge"
    [ -s "$folder/munge/key" ] || (umask 077 && head -c 1024 /dev/urandom >"$folder/munge/key")
    cat >"$conf" <<CONF
ClusterName=here
SlurmctldHost=$(hostname -s)(127.0.0.1)
SlurmUser=$user
SlurmdUser=$user
SlurmctldPort=$port
SlurmdPort=$((port + 1))
AuthType=auth/munge
# A job that lost its node is started again once its credentials have run out: after 6 seconds, not 121.
AuthInfo=socket=$folder/munge/socket,cred_expire=5
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
ReturnToService=2
# A node that is lost is noticed after 12 seconds, not 26.
SlurmdTimeout=5
MessageTimeout=3
TCPTimeout=1
SlurmctldTimeout=10
InactiveLimit=0
KillWait=10
MinJobAge=300
SchedulerParameters=sched_interval=5
MailProg=/bin/true
NodeName=here NodeHostname=$(hostname -s) NodeAddr=127.0.0.1 CPUs=$slots RealMemory=$memory State=UNKNOWN
PartitionName=all Nodes=here Default=YES MaxTime=INFINITE State=UP OverSubscribe=NO
CONF
}

start_node() { slurmd -N here -f "$conf"; }

wait_for() { # seconds, what, command: until the command succeeds
    local until=$((SECONDS + $1)) what=$2
    shift 2
    until "$@" >/dev/null 2>&1; do
        [ $SECONDS -lt $until ] || { echo "slurm-here.sh: $what; see $folder/*.log" >&2; exit 1; }
        sleep 0.5
    done
}

idle() { sinfo -h -o %T | grep -qE '^(idle|mixed|allocated)$'; }

ask() { # pid file, signal: tell the process that it names to stop
    [ ! -s "$1" ] || kill "-${2:-TERM}" "$(<"$1")" 2>/dev/null || true
}

end() { # pid file, signal: stop the process that it names, and wait for its end
    local pid
    [ -s "$1" ] || return 0
    pid=$(<"$1")
    ask "$1" "${2:-TERM}"
    for _ in $(seq 100); do
        kill -0 "$pid" 2>/dev/null || break
        sleep 0.1
    done
    kill -KILL "$pid" 2>/dev/null || true
    rm -f "$1"
}

case $action in
start)
    need
    [ "$(id -u)" = 0 ] || { echo "slurm-here.sh: run it as root (the node starts jobs, and $link is a link)" >&2; exit 2; }
    if [ -e "$link" ] && [ "$(readlink "$link")" != "$conf" ]; then
        echo "slurm-here.sh: this machine has a Slurm already: $link" >&2
        exit 2
    fi
    configure
    mkdir -p "$(dirname "$link")"
    ln -sfn "$conf" "$link"
    munged --key-file="$folder/munge/key" --socket="$folder/munge/socket" --pid-file="$folder/munge/pid" \
        --log-file="$folder/munge/log" --seed-file="$folder/munge/seed" --force 2>/dev/null
    slurmctld -f "$conf"
    start_node
    wait_for 60 "the node did not come up" idle
    ;;
kill-node)
    tasks=$(scontrol listpids 2>/dev/null | awk '$1 + 0 > 0 { print $1 }')
    # shellcheck disable=SC2086  # a list
    keepers=$(for pid in $tasks; do ps -o ppid= -p "$pid"; done | sort -u |
        while read -r pid; do [ "$(ps -o comm= -p "$pid")" != slurmstepd ] || echo "$pid"; done)
    end "$folder/slurmd.pid" KILL
    # shellcheck disable=SC2086
    [ -z "$keepers$tasks" ] || kill -KILL $keepers $tasks 2>/dev/null || true
    ;;
start-node) start_node ;;
stop)
    if [ -s "$folder/slurmctld.pid" ] && kill -0 "$(<"$folder/slurmctld.pid")" 2>/dev/null; then
        timeout 10 scancel --user="$(id -un)" 2>/dev/null || true
        for _ in $(seq 30); do
            [ -n "$(timeout 10 squeue -h 2>/dev/null)" ] || break
            sleep 0.5
        done
    fi
    ask "$folder/slurmctld.pid" # both at once, for each takes its time
    end "$folder/slurmd.pid"
    end "$folder/slurmctld.pid"
    end "$folder/munge/pid"
    [ "$(readlink "$link")" != "$conf" ] || rm -f "$link"
    ;;
esac
