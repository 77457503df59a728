/PROG  LINES
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 12;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:  !Approach, P[9] is not here ;
   2:  UFRAME_NUM=1 ;
   3:  UTOOL_NUM=2 ;
   4:  PAYLOAD[1] ;
   5:J P[1] 100% FINE     ;
   6:L P[2:above part] 500mm/sec CNT100 ACC50 ;
   7:L P[3] 120cm/min CNT100 TB    .10sec,CALL SET_OFFSET(PR[1])     ;
   8:L P[4] 2.5sec FINE ;
   9:  JMP LBL[1] ;
  10:  LBL[1:end] ;
  11:L P[2:above part] R[5:speed]mm/sec FINE PTH ;
  12:J @P[5:"home"] 20% CNT0 DA 10.0mm ;
/POS
P[1]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   414.643  mm,	Y =  -253.695  mm,	Z =   483.402  mm,
	W =   170.613 deg,	P =     5.582 deg,	R =   -76.579 deg
};
P[2:"above part"]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   -13.227  mm,	Y =  -212.937  mm,	Z =   334.489  mm,
	W =  -159.970 deg,	P =     8.921 deg,	R =   -48.252 deg
};
P[3]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   578.822  mm,	Y =   -36.926  mm,	Z =   654.568  mm,
	W =  -167.155 deg,	P =   -19.847 deg,	R =  -139.551 deg
};
P[4]{
   GP1:
	UF : 1, UT : 2,		CONFIG : 'N U T, 0, 0, 0',
	X =   503.878  mm,	Y =  -437.938  mm,	Z =   199.763  mm,
	W =  -143.435 deg,	P =    20.923 deg,	R =  -115.183 deg
};
P[5:"home"]{
   GP1:
	UF : 0, UT : 0,		CONFIG : 'N U T, 0, 0, 0',
	X =   662.016  mm,	Y =  -664.697  mm,	Z =   423.103  mm,
	W =  -123.833 deg,	P =    13.068 deg,	R =   136.711 deg
};
/END
